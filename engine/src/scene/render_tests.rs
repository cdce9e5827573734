//! Merged rendering and labels on analytic fields: a road, a wall, a parked car in the background, and inserted boxes.

use std::collections::BTreeMap;
use std::sync::Arc;

use glam::{DVec2, DVec3, Vec3};

use super::box_world::{camera, forward_from_camera};
use super::composition::{Composition, LeftOut, Origin, PlacedObject};
use super::frame::RenderedFrame;
use super::labels::{FrameLabel, label};
use super::projection::corners;
use super::recorded::{InstanceMask, RecordedImage, needs_recorded, show_recorded};
use super::recording::RecordedTrack;
use super::render::{RenderOptions, Scene, render};
use super::silhouette::{Shape, silhouette};
use super::solid_field::solid_field;
use super::valid_region::ValidRegion;
use crate::camera::Rigid;
use crate::class::ObjectClass;
use crate::{Error, Field};

const CAR: DVec3 = DVec3::new(4.0, 2.0, 1.6);
const PARKED_AT: DVec3 = DVec3::new(16.0, -4.0, 0.8);

/// Road at z = 0, a parked car, and a wall across the road at x = 25 on the left side.
fn background() -> Arc<Field> {
    let (low, high) = (Vec3::new(0.0, -10.0, -1.0), Vec3::new(30.0, 10.0, 3.8));
    let sigma = |p: Vec3| {
        let parked = (p - PARKED_AT.as_vec3()).abs();
        let in_car = parked.cmple(CAR.as_vec3() * 0.5).all();
        let in_wall = (25.0..26.0).contains(&p.x) && p.y > 2.0;
        if p.z <= -0.1 || in_car || in_wall {
            60.0
        } else {
            0.0
        }
    };
    Arc::new(solid_field(low, high, 0.2, [0.3, 0.3, 0.35], sigma))
}

fn car(rgb: [f32; 3], sigma: f32) -> Arc<Field> {
    let half = (CAR * 0.5).as_vec3();
    let pad = Vec3::splat(0.2);
    let sigma = |p: Vec3| {
        if p.abs().cmple(half).all() {
            sigma
        } else {
            0.0
        }
    };
    Arc::new(solid_field(-half - pad, half + pad, 0.1, rgb, sigma))
}

fn placed(id: u16, origin: Origin, asset: Option<usize>, x: f64, y: f64) -> PlacedObject {
    PlacedObject {
        instance_id: id,
        origin,
        class: ObjectClass::Car,
        size_m: CAR,
        local_from_object: Rigid::from_heading(0.3, DVec3::new(x, y, 0.8)),
        asset,
        track_id: None,
        beyond_coverage: false,
        velocity_mps: None,
    }
}

fn composition(objects: Vec<PlacedObject>) -> Composition {
    Composition {
        frame: 0,
        camera: camera().resized(160, 96),
        local_from_camera: Rigid::new(forward_from_camera(), DVec3::new(0.5, 0.0, 1.5)),
        local_from_ego: Rigid::IDENTITY,
        objects,
        left_out: Vec::new(),
        rejections: BTreeMap::new(),
        insert_shadows: false,
        daylight: None,
    }
}

fn shoot(
    background: &Arc<Field>,
    library: &[&Arc<Field>],
    composition: &Composition,
) -> RenderedFrame {
    let scene =
        Scene::of_composition(background, composition, |i| library.get(i).copied()).unwrap();
    render(&scene, &RenderOptions::default(), &|| false).unwrap()
}

fn labels(composition: &Composition, frame: &RenderedFrame) -> Vec<FrameLabel> {
    let region = ValidRegion::unseen(DVec2::ZERO, 0.5, 1, 1);
    label(composition, &region, frame)
}

#[test]
fn labels_are_exactly_the_instance_pixels() {
    let (background, red) = (background(), car([0.8, 0.1, 0.1], 60.0));
    let mut parked = placed(3, Origin::Static, None, PARKED_AT.x, PARKED_AT.y);
    parked.local_from_object = Rigid::from_heading(0.0, PARKED_AT);
    let composition = composition(vec![
        placed(1, Origin::Inserted, Some(0), 10.0, 1.0),
        placed(2, Origin::Inserted, Some(0), 14.0, 3.0),
        parked,
    ]);
    let frame = shoot(&background, &[&red], &composition);
    let labels = labels(&composition, &frame);
    assert_eq!(labels.len(), 3);
    let owned: u32 = labels.iter().map(|l| l.visible_px).sum();
    let mask = frame.instance.iter().filter(|i| **i != 0).count();
    assert_eq!(owned as usize, mask);
    for label in &labels {
        for (i, instance) in frame.instance.iter().enumerate() {
            let (x, y) = ((i % 160) as f64, (i / 160) as f64);
            let inside = x >= label.visible.min.x
                && y >= label.visible.min.y
                && x < label.visible.max.x
                && y < label.visible.max.y;
            assert!(inside || *instance != label.instance_id, "pixel {x},{y}");
        }
        assert!(label.visible_fraction > 0.0 && label.visible_fraction <= 1.0);
        assert!(label.lidar_points > 0);
    }
    assert!(labels[1].visible_fraction < 0.7, "hidden by the first");
    assert_eq!(labels[1].occluder, 1);
    assert!(labels[0].visible_fraction > 0.99);
}

#[test]
fn a_mask_covers_the_exact_silhouette_at_the_exact_depth() {
    let (background, red) = (background(), car([0.8, 0.1, 0.1], 200.0));
    let composition = composition(vec![placed(1, Origin::Inserted, Some(0), 10.0, 0.5)]);
    let frame = shoot(&background, &[&red], &composition);
    let camera_from_object =
        composition.local_from_camera.inverse() * composition.objects[0].local_from_object;
    let (mut both, mut either, mut depth_error) = (0.0, 0.0, 0.0f64);
    for (i, instance) in frame.instance.iter().enumerate() {
        let pixel = DVec2::new((i % 160) as f64 + 0.5, (i / 160) as f64 + 0.5);
        let exact = entry(&camera_from_object, composition.camera.direction(pixel));
        let (a, b) = (*instance == 1, exact.is_some());
        either += f64::from(u8::from(a || b));
        if let (true, Some(z)) = (a, exact) {
            both += 1.0;
            depth_error += (f64::from(frame.depth_z_m[i]) - z).abs();
        }
    }
    assert!(both / either > 0.88, "IoU {}", both / either);
    assert!(depth_error / both < 0.15, "mean {}", depth_error / both);
    assert!(both > 300.0);
    let label = &labels(&composition, &frame)[0];
    let amodal = label.amodal.unwrap();
    for p in corners(&camera_from_object, CAR) {
        let px = composition.camera.project(p).unwrap();
        assert!(px.cmpge(amodal.min - 1e-9).all() && px.cmple(amodal.max + 1e-9).all());
    }
}

/// Camera z at which a ray enters the cuboid.
fn entry(camera_from_object: &Rigid, direction: DVec3) -> Option<f64> {
    let inverse = camera_from_object.inverse();
    let (origin, d) = (inverse.translation_m, inverse.direction(direction));
    let (a, b) = ((-CAR * 0.5 - origin) / d, (CAR * 0.5 - origin) / d);
    let (enter, leave) = (a.min(b).max_element(), a.max(b).min_element());
    (enter < leave && enter > 0.0).then_some(enter * direction.z)
}

#[test]
fn an_empty_object_changes_no_pixel_and_gets_no_label() {
    let (background, nothing) = (background(), car([0.8, 0.1, 0.1], 0.0));
    let with = composition(vec![placed(1, Origin::Inserted, Some(0), 10.0, 0.5)]);
    let frame = shoot(&background, &[&nothing], &with);
    let without = shoot(&background, &[], &composition(Vec::new()));
    assert_eq!(frame.rgb8, without.rgb8);
    assert_eq!(frame.depth_z_m, without.depth_z_m);
    assert_eq!(frame.instance, without.instance);
    assert_eq!(frame.accumulation, without.accumulation);
    assert!(labels(&with, &frame).is_empty());
    let solid = car([0.8, 0.1, 0.1], 60.0);
    assert_ne!(shoot(&background, &[&solid], &with).rgb8, without.rgb8);
}

#[test]
fn the_order_of_objects_changes_nothing() {
    let background = background();
    let (red, blue) = (car([0.8, 0.1, 0.1], 3.0), car([0.1, 0.2, 0.8], 3.0));
    // Overlapping on purpose: their densities add.
    let mut objects = vec![
        placed(1, Origin::Inserted, Some(0), 10.0, 0.5),
        placed(2, Origin::Inserted, Some(1), 11.0, 1.5),
        placed(3, Origin::Inserted, Some(0), 18.0, -1.0),
    ];
    let forward = shoot(&background, &[&red, &blue], &composition(objects.clone()));
    objects.reverse();
    let mut backward = shoot(&background, &[&red, &blue], &composition(objects));
    backward.alone_px.reverse();
    assert_eq!(forward, backward);
}

#[test]
fn nothing_visible_means_no_label() {
    let (background, red) = (background(), car([0.8, 0.1, 0.1], 60.0));
    // Behind the wall.
    let behind = composition(vec![placed(1, Origin::Inserted, Some(0), 28.4, 7.0)]);
    let frame = shoot(&background, &[&red], &behind);
    assert!(frame.instance.iter().all(|i| *i == 0));
    assert!(labels(&behind, &frame).is_empty());
    assert!(frame.alone_px[0].1 > 0);
    assert!(frame.hidden_px[&(1, 0)] > 0);
}

#[test]
fn an_insert_takes_visibility_from_a_parked_car() {
    let (background, red) = (background(), car([0.8, 0.1, 0.1], 60.0));
    let mut parked = placed(1, Origin::Static, None, 0.0, 0.0);
    parked.local_from_object = Rigid::from_heading(0.0, PARKED_AT);
    let alone = composition(vec![parked.clone()]);
    let free = labels(&alone, &shoot(&background, &[], &alone))[0].clone();
    assert!(
        free.visible_px > 50 && free.visible_fraction == 1.0,
        "{free:?}"
    );
    let before = composition(vec![
        parked,
        placed(2, Origin::Inserted, Some(0), 9.0, -0.9),
    ]);
    let frame = shoot(&background, &[&red], &before);
    let hidden = labels(&before, &frame)
        .into_iter()
        .find(|l| l.instance_id == 1);
    let hidden = hidden.expect("still partly visible");
    assert!(hidden.visible_fraction < 0.8, "{}", hidden.visible_fraction);
    assert_eq!(hidden.occluder, 2);
}

#[test]
fn haze_in_an_objects_box_goes_and_the_ground_stays() {
    // Haze of 0.5/m everywhere above the road; the car is solid only in its right half.
    let (low, high) = (Vec3::new(6.0, -4.0, -1.0), Vec3::new(14.0, 4.0, 2.2));
    let sigma = |p: Vec3| if p.z <= 0.0 { 60.0 } else { 0.5 };
    let hazy = Arc::new(solid_field(low, high, 0.2, [0.9, 0.9, 0.1], sigma));
    let red = car([0.8, 0.1, 0.1], 60.0);
    let scene = composition(vec![placed(1, Origin::Inserted, Some(0), 10.0, 0.0)]);
    let frame = shoot(&hazy, &[&red], &scene);
    let bottom = scene
        .camera
        .project(
            scene
                .local_from_camera
                .inverse()
                .point(DVec3::new(7.2, 0.0, 0.0)),
        )
        .unwrap();
    let ground = (bottom.y as usize) * 160 + bottom.x as usize;
    assert_eq!(frame.instance[ground], 0);
    assert!(
        frame.accumulation[ground] > 0.9,
        "the road before the car is there"
    );
    // Through the box the only light lost is the car's and the haze before it.
    assert!(frame.alone_px[0].1 > 200);
}

#[test]
fn cancelling_stops_and_bad_poses_are_refused() {
    let background = background();
    let plain = composition(Vec::new());
    let scene = Scene::of_composition(&background, &plain, |_| None).unwrap();
    let stopped = render(&scene, &RenderOptions::default(), &|| true);
    assert!(matches!(stopped, Err(Error::Cancelled)));
    let broken = Scene {
        local_from_camera: Rigid::new(glam::DQuat::IDENTITY, DVec3::NAN),
        ..scene
    };
    let refused = render(&broken, &RenderOptions::default(), &|| false);
    assert!(matches!(refused, Err(Error::Invalid { .. })));
    let missing = composition(vec![placed(1, Origin::Inserted, Some(0), 10.0, 0.0)]);
    assert!(Scene::of_composition(&background, &missing, |_| None).is_err());
}

#[test]
fn a_recorded_mover_takes_its_pixels_from_the_image_behind_what_stands_nearer() {
    let (background, red) = (background(), car([0.8, 0.1, 0.1], 60.0));
    let composition = composition(vec![
        placed(1, Origin::Inserted, Some(0), 10.0, 1.8),
        placed(2, Origin::Recorded, None, 16.0, 0.0),
        placed(3, Origin::Inserted, Some(0), 22.0, -1.9),
    ]);
    let before = shoot(&background, &[&red], &composition);
    let mut frame = before.clone();
    let recorded = RecordedImage {
        width: 2,
        height: 1,
        rgb8: &[7, 200, 9].repeat(2),
        masks: None,
    };
    let shown = show_recorded(&composition, &recorded, &[false; 160 * 96], &mut frame);
    let labels = labels(&composition, &frame);
    let of = |id: u16| labels.iter().find(|l| l.instance_id == id).unwrap();
    assert!(of(2).visible_fraction > 0.2 && of(2).visible_fraction < 1.0);
    assert_eq!(of(2).occluder, 1);
    assert_eq!(of(3).occluder, 2);
    for (i, (now, then)) in frame.instance.iter().zip(&before.instance).enumerate() {
        let color = &frame.rgb8[3 * i..3 * i + 3];
        match *now {
            2 if frame.placed_alpha[i] == 0.0 => assert_eq!(color, [7, 200, 9]),
            1 if !frame.shows_behind(i) => assert!(close(color, &before.rgb8[3 * i..3 * i + 3])),
            _ => assert!(
                *now == 1 || *then != 1,
                "the nearer insert keeps its pixels"
            ),
        }
        if shown[i] == 0.0 {
            assert_eq!(color, &before.rgb8[3 * i..3 * i + 3], "out of reach");
        }
    }
    let owned: u32 = labels.iter().map(|l| l.visible_px).sum();
    let mask = frame.instance.iter().filter(|i| **i != 0).count();
    assert_eq!(owned as usize, mask);
}

#[test]
fn around_a_replayed_mover_the_recorded_image_shows_and_nothing_placed_changes() {
    let (background, red) = (background(), car([0.8, 0.1, 0.1], 60.0));
    let composition = composition(vec![
        placed(1, Origin::Inserted, Some(0), 10.0, 1.8),
        placed(2, Origin::Replayed, Some(0), 16.0, 0.0),
    ]);
    assert!(needs_recorded(&composition));
    let before = shoot(&background, &[&red], &composition);
    let mut frame = before.clone();
    let recorded = RecordedImage {
        width: 1,
        height: 1,
        rgb8: &[7, 200, 9],
        masks: None,
    };
    let shown = show_recorded(&composition, &recorded, &[false; 160 * 96], &mut frame);
    assert_eq!(frame.instance, before.instance);
    let (mut whole, mut part, mut body) = (0, 0, 0);
    for (i, instance) in frame.instance.iter().enumerate() {
        let (now, then) = (
            &frame.rgb8[3 * i..3 * i + 3],
            &before.rgb8[3 * i..3 * i + 3],
        );
        if *instance == 1 && !frame.shows_behind(i) {
            assert!(close(now, then), "placed objects stay");
        } else if shown[i] == 0.0 && *instance != 2 {
            assert_eq!(now, then, "out of reach");
        } else if *instance == 0 && shown[i] == 1.0 && frame.placed_alpha[i] == 0.0 {
            assert_eq!(now, [7, 200, 9]);
            whole += 1;
        } else {
            part += usize::from(now != then && now != [7, 200, 9]);
            body += usize::from(*instance == 2 && now == then);
        }
    }
    assert!(whole > 100, "{whole}");
    assert!(part > 50, "no hard edge anywhere: {part}");
    assert!(body > 20, "the mover itself is rendered: {body}");
}

/// Up to a thousandth of what lies behind an object still shows.
fn close(a: &[u8], b: &[u8]) -> bool {
    a.iter().zip(b).all(|(a, b)| a.abs_diff(*b) <= 1)
}

#[test]
fn left_out_movers_pixels_are_not_shown_again() {
    let background = background();
    let mut composition = composition(Vec::new());
    let mover = placed(1, Origin::Recorded, None, 16.0, 0.0);
    composition.left_out = vec![LeftOut {
        track_id: "lead".into(),
        occupied: mover.occupied(),
        asset: None,
    }];
    let mut frame = shoot(&background, &[], &composition);
    let before = frame.clone();
    let begins = silhouette(
        &composition.camera,
        &composition.local_from_camera.inverse(),
        &mover.occupied(),
        Shape::Cuboid,
    );
    let hidden: Vec<bool> = begins.iter().map(|z| z.is_finite()).collect();
    let recorded = RecordedImage {
        width: 1,
        height: 1,
        rgb8: &[7, 200, 9],
        masks: None,
    };
    let shown = show_recorded(&composition, &recorded, &hidden, &mut frame);
    assert!(hidden.contains(&true) && shown.contains(&1.0));
    for i in (0..hidden.len()).filter(|i| hidden[*i]) {
        assert_eq!(frame.behind_rgb[i], before.behind_rgb[i]);
        assert_eq!(shown[i], 0.0);
    }
}

#[test]
fn a_model_narrows_a_silhouette_to_what_it_shows() {
    let composition = composition(Vec::new());
    let mover = placed(1, Origin::Recorded, None, 14.0, 1.0).occupied();
    let camera_from_local = composition.local_from_camera.inverse();
    let (camera, whole) = (&composition.camera, car([0.5; 3], 60.0));
    // Only the rear half is solid: seen from behind it hides less of the image than the cuboid.
    let half = (CAR * 0.5).as_vec3();
    let slim = solid_field(-half - 0.2, half + 0.2, 0.1, [0.5; 3], |p| {
        let inside = p.abs().cmple(half * Vec3::new(1.0, 0.5, 1.0)).all();
        if inside { 60.0 } else { 0.0 }
    });
    let count = |model: Option<&Field>| {
        let begins = silhouette(camera, &camera_from_local, &mover, Shape::best(None, model));
        begins.iter().filter(|z| z.is_finite()).count()
    };
    let mask: Vec<bool> = (0..160 * 96).map(|i| i % 160 < 70).collect();
    let begins = silhouette(camera, &camera_from_local, &mover, Shape::Mask(&mask));
    let masked = begins.iter().filter(|z| z.is_finite()).count();
    assert!(masked > 0 && masked < count(None), "{masked}");
    let (padded, full, slim) = (count(None), count(Some(&whole)), count(Some(&slim)));
    assert!(slim < full && full <= padded, "{slim} {full} {padded}");
    assert!(slim * 3 > full, "{slim} {full}");
    let nothing = car([0.5; 3], 0.0);
    assert!(count(Some(&nothing)) < full, "wheels only");
}

#[test]
fn the_logs_mask_cuts_a_recorded_mover_out() {
    let background = background();
    let mover = PlacedObject {
        track_id: Some("b".into()),
        ..placed(1, Origin::Recorded, None, 16.0, 0.0)
    };
    let composition = composition(vec![mover.clone()]);
    let tracks = ["a", "b"].map(|id| RecordedTrack {
        track_id: id.into(),
        class: ObjectClass::Car,
        size_m: CAR,
        moving: true,
        local_from_cuboid: Vec::new(),
    });
    // The left half of the image belongs to track b, the right half to track a.
    let values: Vec<u16> = (0..160 * 96)
        .map(|i| if i % 160 < 80 { 2 } else { 1 })
        .collect();
    let rgb8 = vec![40u8; 3 * 160 * 96];
    let owned = |masks: Option<InstanceMask<'_>>| {
        let mut frame = shoot(&background, &[], &composition);
        let recorded = RecordedImage {
            width: 160,
            height: 96,
            rgb8: &rgb8,
            masks,
        };
        show_recorded(&composition, &recorded, &[false; 160 * 96], &mut frame);
        let own = (0..frame.instance.len()).filter(|i| frame.instance[*i] == 1);
        own.map(|i| i % 160 < 80).collect::<Vec<bool>>()
    };
    let by_cuboid = owned(None);
    assert!(by_cuboid.contains(&true) && by_cuboid.contains(&false));
    let by_mask = owned(Some(InstanceMask {
        values: &values,
        tracks: &tracks,
    }));
    assert!(by_mask.len() > 20 && by_mask.iter().all(|left| *left));
    // A mask that shows nothing of the track says nothing; one read with the tracks in another order cuts the other half.
    let elsewhere = vec![7u16; values.len()];
    let unknown = InstanceMask {
        values: &elsewhere,
        tracks: &tracks,
    };
    assert_eq!(owned(Some(unknown)), by_cuboid);
    let [a, b] = tracks;
    let swapped = [b, a];
    let wrong = owned(Some(InstanceMask {
        values: &values,
        tracks: &swapped,
    }));
    assert!(wrong.iter().all(|left| !*left));
}

/// A ball whose colour depends on the direction it is seen from.
fn iridescent() -> Arc<Field> {
    let sigma = |p: Vec3| if p.length() < 0.9 { 60.0 } else { 0.0 };
    let mut ball = solid_field(Vec3::splat(-1.1), Vec3::splat(1.1), 0.1, [0.5; 3], sigma);
    let mut draws = super::random::Draws::new(5, 0, 0);
    ball.mlp = crate::field::ColorMlp::new(16, || draws.unit());
    Arc::new(ball)
}

#[test]
fn an_object_is_seen_from_its_own_side() {
    let ball = iridescent();
    let shot = |camera_turn: f64, object_turn: f64| {
        let about = |turn: f64| Rigid::from_heading(turn, DVec3::new(10.0, 0.0, 1.5));
        let scene = Scene {
            background: None,
            objects: vec![super::render::SceneObject {
                instance_id: 1,
                field: &ball,
                local_from_object: about(object_turn),
                size_m: DVec3::splat(2.0),
                tone: super::tone::Tone::IDENTITY,
            }],
            statics: Vec::new(),
            camera: camera().resized(160, 96),
            local_from_camera: about(camera_turn)
                * Rigid::new(forward_from_camera(), DVec3::new(-7.0, 0.0, 0.0)),
        };
        let frame = render(&scene, &RenderOptions::default(), &|| false).unwrap();
        let (mut sum, mut weight) = (DVec3::ZERO, 0.0);
        for (rgb, alpha) in frame.placed_rgb.iter().zip(&frame.placed_alpha) {
            sum += DVec3::from_array(rgb.map(f64::from));
            weight += f64::from(*alpha);
        }
        sum / weight
    };
    let straight = shot(0.0, 0.0);
    // Camera and object turn together: nothing changes. The object alone turns: another side of it is seen, which a view direction
    // that stayed in the scene's frame would not show.
    assert!((shot(1.3, 1.3) - straight).length() < 2e-3);
    assert!((shot(0.0, 1.3) - straight).length() > 0.02);
}

#[test]
fn a_small_far_object_is_not_stepped_over() {
    // Stripes of two voxels; a pixel spans three.
    let half = (CAR * 0.5).as_vec3();
    let sigma = |p: Vec3| if p.abs().cmple(half).all() { 60.0 } else { 0.0 };
    let mut car = solid_field(-half - 0.2, half + 0.2, 0.1, [0.5; 3], sigma);
    super::solid_field::tint(&mut car, |p| {
        if ((p.y + 10.0) * 5.0) as i32 % 2 == 0 {
            2.0
        } else {
            -2.0
        }
    });
    let (car, background) = (Arc::new(car), background());
    let mut far = composition(vec![placed(1, Origin::Inserted, Some(0), 29.0, 0.0)]);
    far.objects[0].local_from_object = Rigid::from_heading(0.0, DVec3::new(29.0, 0.0, 0.8));
    let scene = Scene::of_composition(&background, &far, |_| Some(&car)).unwrap();
    let shot = |supersample: u32, object_supersample: u32| {
        let options = RenderOptions {
            supersample,
            object_supersample,
        };
        render(&scene, &options, &|| false).unwrap()
    };
    let exact = shot(12, 12);
    let error = |frame: &RenderedFrame| {
        let own = (0..exact.instance.len()).filter(|i| exact.placed_alpha[*i] > 0.3);
        let error =
            |i: usize| (f64::from(frame.rgb8[3 * i]) - f64::from(exact.rgb8[3 * i])).powi(2);
        own.map(error).sum::<f64>().sqrt()
    };
    let default = RenderOptions::default().object_supersample;
    let (single, filtered) = (error(&shot(1, 1)), error(&shot(1, default)));
    assert!(filtered < 0.4 * single, "{filtered} against {single}");
}
