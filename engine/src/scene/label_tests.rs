//! Exact invariants of labels over random scenes, each with a broken sibling that the same check refuses.

use std::collections::BTreeMap;
use std::sync::Arc;

use glam::{DVec2, DVec3, Vec3};
use proptest::prelude::*;

use super::box_world::{camera, forward_from_camera};
use super::composition::{Composition, Origin, PlacedObject};
use super::frame::RenderedFrame;
use super::labels::{FrameLabel, label};
use super::render::{RenderOptions, Scene, render};
use super::rle::mask_of_runs;
use super::solid_field::solid_field;
use super::valid_region::ValidRegion;
use crate::camera::Rigid;
use crate::class::ObjectClass;
use crate::field::Field;

const CAR: DVec3 = DVec3::new(4.0, 2.0, 1.6);
const PARKED_AT: DVec3 = DVec3::new(16.0, -4.0, 0.8);
const WIDTH: u32 = 96;
const HEIGHT: u32 = 56;

struct Fields {
    background: Arc<Field>,
    /// Solid, thin and empty.
    cars: [Arc<Field>; 3],
}

impl Fields {
    fn new() -> Self {
        let (low, high) = (Vec3::new(0.0, -10.0, -1.0), Vec3::new(30.0, 10.0, 3.8));
        let background = solid_field(low, high, 0.25, [0.3, 0.3, 0.35], |p| {
            let parked = (p - PARKED_AT.as_vec3()).abs();
            let in_car = parked.cmple(CAR.as_vec3() * 0.5).all();
            let in_wall = (25.0..26.0).contains(&p.x) && p.y > 2.0;
            if p.z <= -0.1 || in_car || in_wall {
                60.0
            } else {
                0.0
            }
        });
        let car = |sigma: f32| {
            let half = (CAR * 0.5).as_vec3();
            solid_field(-half - 0.2, half + 0.2, 0.2, [0.8, 0.1, 0.1], |p| {
                if p.abs().cmple(half).all() {
                    sigma
                } else {
                    0.0
                }
            })
        };
        Self {
            background: Arc::new(background),
            cars: [car(60.0), car(1.0), car(0.0)].map(Arc::new),
        }
    }

    fn shoot(&self, composition: &Composition) -> RenderedFrame {
        let field = |i: usize| self.cars.get(i);
        let scene = Scene::of_composition(&self.background, composition, field).unwrap();
        render(&scene, &RenderOptions::default(), &|| false).unwrap()
    }
}

fn object(id: u16, asset: Option<usize>, x: f64, y: f64, heading: f64) -> PlacedObject {
    PlacedObject {
        instance_id: id,
        origin: match asset {
            Some(_) => Origin::Inserted,
            None => Origin::Static,
        },
        class: ObjectClass::Car,
        size_m: CAR,
        local_from_object: Rigid::from_heading(heading, DVec3::new(x, y, 0.8)),
        asset,
        track_id: None,
        beyond_coverage: false,
        velocity_mps: None,
    }
}

fn composition(objects: Vec<PlacedObject>) -> Composition {
    Composition {
        frame: 0,
        camera: camera().resized(WIDTH, HEIGHT),
        local_from_camera: Rigid::new(forward_from_camera(), DVec3::new(0.5, 0.0, 1.5)),
        local_from_ego: Rigid::IDENTITY,
        objects,
        left_out: Vec::new(),
        rejections: BTreeMap::new(),
        insert_shadows: false,
        daylight: None,
    }
}

fn labels(composition: &Composition, frame: &RenderedFrame) -> Vec<FrameLabel> {
    label(
        composition,
        &ValidRegion::unseen(DVec2::ZERO, 0.5, 1, 1),
        frame,
    )
}

/// Everything in which labels and the instance image disagree.
fn faults(composition: &Composition, frame: &RenderedFrame, labels: &[FrameLabel]) -> Vec<String> {
    let mut faults = Vec::new();
    let mut told = vec![0u16; frame.instance.len()];
    for label in labels {
        let id = label.instance_id;
        let mask = mask_of_runs(&label.mask_runs, WIDTH as usize, HEIGHT as usize);
        let mut bounds: Option<(DVec2, DVec2)> = None;
        for i in (0..mask.len()).filter(|i| mask[*i]) {
            if told[i] != 0 {
                faults.push(format!("pixel {i} has two owners"));
            }
            told[i] = id;
            let corner = frame.pixel_centre(i) - 0.5;
            let (min, max) = bounds.get_or_insert((corner, corner + 1.0));
            (*min, *max) = (min.min(corner), max.max(corner + 1.0));
        }
        let visible = (label.visible.min, label.visible.max);
        if bounds != Some(visible) {
            faults.push(format!(
                "{id}: visible box {visible:?}, its pixels {bounds:?}"
            ));
        }
        if mask.iter().filter(|m| **m).count() != label.visible_px as usize {
            faults.push(format!("{id}: {} visible pixels", label.visible_px));
        }
        if !(label.visible_fraction > 0.0 && label.visible_fraction <= 1.0) {
            faults.push(format!("{id}: visible fraction {}", label.visible_fraction));
        }
        let known = |other: u16| composition.objects.iter().any(|o| o.instance_id == other);
        if !known(id) || label.occluder == id || (label.occluder != 0 && !known(label.occluder)) {
            faults.push(format!("{id}: occluder {}", label.occluder));
        }
        let by_world = composition.local_from_camera * label.camera_from_object;
        let by_ego = composition.local_from_ego * label.ego_from_object;
        for pose in [by_world, by_ego] {
            let off = pose.translation_m - label.local_from_object.translation_m;
            if off.length() > 1e-9 {
                faults.push(format!("{id}: its frames disagree by {off}"));
            }
        }
    }
    // The sum of the instances' pixels is the mask.
    if told != frame.instance {
        faults.push("the labels' masks are not the instance image".to_owned());
    }
    faults
}

type Place = (usize, f64, f64, f64);

fn places() -> impl Strategy<Value = Vec<Place>> {
    prop::collection::vec((0usize..3, 6.0f64..28.0, -7.0f64..7.0, -3.0f64..3.0), 0..5)
}

fn scene(places: &[Place]) -> Composition {
    let objects = places.iter().enumerate();
    let mut objects: Vec<PlacedObject> = objects
        .map(|(i, &(asset, x, y, heading))| object(i as u16 + 1, Some(asset), x, y, heading))
        .collect();
    objects.push(object(9, None, PARKED_AT.x, PARKED_AT.y, 0.0));
    composition(objects)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn labels_tell_the_instance_image_and_nothing_else(places in places()) {
        let fields = Fields::new();
        let composition = scene(&places);
        let frame = fields.shoot(&composition);
        let labels = labels(&composition, &frame);
        prop_assert_eq!(faults(&composition, &frame, &labels), Vec::<String>::new());
        let owns = |id: u16| frame.instance.contains(&id);
        for object in &composition.objects {
            let labelled = labels.iter().any(|l| l.instance_id == object.instance_id);
            prop_assert_eq!(labelled, owns(object.instance_id), "{}", object.instance_id);
        }
    }

    #[test]
    fn empty_objects_change_no_pixel_and_no_label(places in places()) {
        let fields = Fields::new();
        let whole = scene(&places);
        let mut without = whole.clone();
        without.objects.retain(|o| o.asset != Some(2));
        let (full, bare) = (fields.shoot(&whole), fields.shoot(&without));
        prop_assert!(full.rgb8 == bare.rgb8, "colours differ");
        prop_assert!(full.instance == bare.instance, "instances differ");
        prop_assert!(full.depth_z_m == bare.depth_z_m, "depths differ");
        prop_assert!(full.accumulation == bare.accumulation, "accumulations differ");
        prop_assert_eq!(labels(&whole, &full), labels(&without, &bare));
    }

    #[test]
    fn the_order_of_objects_changes_nothing(places in places(), turn in 0usize..5) {
        let fields = Fields::new();
        let forward = scene(&places);
        let mut turned = forward.clone();
        let count = turned.objects.len();
        turned.objects.rotate_left(turn % count);
        turned.objects.swap(0, count - 1);
        let (a, b) = (fields.shoot(&forward), fields.shoot(&turned));
        prop_assert!(a.rgb8 == b.rgb8, "colours differ");
        prop_assert!(a.instance == b.instance, "instances differ");
        prop_assert!(a.depth_z_m == b.depth_z_m, "depths differ");
        let sorted = |mut labels: Vec<FrameLabel>| {
            labels.sort_by_key(|l| l.instance_id);
            labels
        };
        prop_assert_eq!(sorted(labels(&forward, &a)), sorted(labels(&turned, &b)));
    }
}

/// Each of the ways in which labels could be wrong is seen by the check that the properties use.
#[test]
fn broken_labels_are_refused() {
    let fields = Fields::new();
    let composition = scene(&[(0, 9.0, 0.5, 0.3), (0, 14.0, 1.5, 1.0)]);
    let frame = fields.shoot(&composition);
    let good = labels(&composition, &frame);
    assert_eq!(good.len(), 3);
    assert!(faults(&composition, &frame, &good).is_empty());
    type Spoil = fn(&mut Vec<FrameLabel>);
    let spoils: [Spoil; 8] = [
        |l| l.truncate(2),
        |l| l[1] = l[0].clone(),
        |l| l[0].visible_px += 1,
        |l| l[0].visible.max.x += 1.0,
        |l| (l[0].mask_runs[0], l[0].mask_runs[1]) = (l[0].mask_runs[0] + 1, l[0].mask_runs[1] - 1),
        |l| l[0].occluder = l[0].instance_id,
        |l| l[2].visible_fraction = 0.0,
        |l| l[0].ego_from_object.translation_m.y += 0.01,
    ];
    for (i, spoil) in spoils.iter().enumerate() {
        let mut labels = good.clone();
        spoil(&mut labels);
        assert!(
            !faults(&composition, &frame, &labels).is_empty(),
            "spoil {i}"
        );
    }
}

/// The properties of empty objects and of order are no matter of course: a thin object and a swapped id change the image.
#[test]
fn thin_objects_and_swapped_ids_show() {
    let fields = Fields::new();
    let thin = scene(&[(1, 9.0, 0.5, 0.3)]);
    let empty = scene(&[(2, 9.0, 0.5, 0.3)]);
    assert!(fields.shoot(&thin).rgb8 != fields.shoot(&empty).rgb8);
    let two = scene(&[(0, 9.0, 0.5, 0.3), (0, 14.0, 1.5, 1.0)]);
    let mut swapped = two.clone();
    swapped.objects[0].instance_id = 2;
    swapped.objects[1].instance_id = 1;
    let (a, b) = (fields.shoot(&two), fields.shoot(&swapped));
    assert!(a.rgb8 == b.rgb8 && a.instance != b.instance);
}

/// The box of an empty object in a wall takes nothing from the wall, whatever else the rays meet.
#[test]
fn an_empty_object_makes_no_hole_beside_another() {
    let fields = Fields::new();
    let both = scene(&[(2, 25.2, 6.7, 0.0), (1, 24.7, 6.6, 0.0)]);
    let mut alone = both.clone();
    alone.objects.retain(|o| o.asset != Some(2));
    assert!(fields.shoot(&both).rgb8 == fields.shoot(&alone).rgb8);
    let solid = scene(&[(0, 25.2, 6.7, 0.0), (1, 24.7, 6.6, 0.0)]);
    assert!(fields.shoot(&solid).rgb8 != fields.shoot(&alone).rgb8);
}

/// A label that stays when an insert covers an original wholly would be one without a pixel.
#[test]
fn an_original_behind_an_insert_loses_its_label() {
    let fields = Fields::new();
    let parked = object(1, None, PARKED_AT.x, PARKED_AT.y, 0.0);
    let alone = composition(vec![parked.clone()]);
    assert_eq!(labels(&alone, &fields.shoot(&alone)).len(), 1);
    // Close to the camera and across the line of sight: it covers the parked car whole.
    let wall = object(2, Some(0), 4.5, -1.0, std::f64::consts::FRAC_PI_2);
    let hidden = composition(vec![parked, wall]);
    let frame = fields.shoot(&hidden);
    let seen: Vec<u16> = labels(&hidden, &frame)
        .iter()
        .map(|l| l.instance_id)
        .collect();
    assert_eq!(seen, [2]);
}
