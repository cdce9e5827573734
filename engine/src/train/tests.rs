//! Training on scenes small enough to trace by hand, and refusing what cannot be trained on.

use std::sync::atomic::{AtomicU64, Ordering};

use glam::{DMat3, DQuat, DVec2, DVec3};

use super::evaluate::evaluate;
use super::fit::Run;
use super::*;
use crate::asset::{AssetHeader, AssetKind, ColorSpace, FORMAT_VERSION, Usage};
use crate::camera::{Camera, Distortion, Rigid};
use crate::class::ObjectClass;
use crate::view::{DepthReturn, PixelLabel, Split, TrainView};
use crate::{Asset, Error};

/// Ground z = 0 with a checkerboard, and a striped box of these half extents around this centre; sky above.
const BOX_HALF: DVec3 = DVec3::new(1.0, 0.6, 0.5);
const BOX_CENTRE: DVec3 = DVec3::new(6.0, 0.0, 0.5);

/// Nearest hit along a unit direction: range and colour.
fn trace(origin: DVec3, direction: DVec3, ground: bool, centre: DVec3) -> Option<(f64, [f64; 3])> {
    let inverse = direction.recip();
    let (a, b) = (
        (centre - BOX_HALF - origin) * inverse,
        (centre + BOX_HALF - origin) * inverse,
    );
    let (near, far) = (a.min(b).max_element(), a.max(b).min_element());
    if near < far && near > 0.0 {
        let p = origin + direction * near - centre;
        let stripe = if (p.x * 3.0).floor() as i64 % 2 == 0 {
            0.8
        } else {
            0.3
        };
        return Some((near, [stripe, 0.2, 0.5 + p.z * 0.6]));
    }
    let t = -origin.z / direction.z;
    if !ground || t <= 0.0 || t > 30.0 {
        return None;
    }
    let p = origin + direction * t;
    let checker = (p.x.floor() + p.y.floor()) as i64 % 2 == 0;
    Some((
        t,
        if checker {
            [0.6, 0.6, 0.55]
        } else {
            [0.35, 0.4, 0.35]
        },
    ))
}

/// Camera axes (x right, y down, z forward) looking from `eye` at `target`.
fn look_at(eye: DVec3, target: DVec3) -> Rigid {
    let forward = (target - eye).normalize();
    let right = forward.cross(DVec3::Z).normalize();
    let rotation = DMat3::from_cols(right, forward.cross(right), forward);
    Rigid::new(DQuat::from_mat3(&rotation).normalize(), eye)
}

fn view(number: u32, pose: Rigid, object: bool) -> TrainView {
    let (width, height) = (64, 48);
    let camera = Camera {
        width,
        height,
        focal_px: DVec2::splat(55.0),
        principal_px: DVec2::new(32.0, 24.0),
        distortion: Distortion::None,
    };
    let centre = if object { DVec3::ZERO } else { BOX_CENTRE };
    let mut view = TrainView {
        frame_index: number,
        camera,
        local_from_camera: pose,
        rgb: Vec::new(),
        labels: Vec::new(),
        depth: Vec::new(),
        split: if number % 5 == 2 {
            Split::HeldOut
        } else {
            Split::Train
        },
    };
    for y in 0..height {
        for x in 0..width {
            let pixel = DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5);
            let direction = pose.direction(camera.direction(pixel));
            let hit = trace(pose.translation_m, direction, !object, centre);
            let color = hit.map_or([0.5, 0.7, 0.9], |h| h.1);
            view.rgb
                .extend(color.map(|c| (c.clamp(0.0, 1.0) * 255.0).round() as u8));
            view.labels.push(match (hit, object) {
                (Some(_), _) => PixelLabel::Foreground,
                (None, true) => PixelLabel::Background,
                (None, false) => PixelLabel::Sky,
            });
            if let (Some((t, _)), 0) = (hit, (x + 3 * y) % 5) {
                let pixel = pixel.as_vec2().to_array();
                view.depth.push(DepthReturn {
                    pixel,
                    range_m: t as f32,
                });
            }
        }
    }
    view
}

fn points(views: &[TrainView]) -> Vec<[f32; 3]> {
    let train = views.iter().filter(|view| view.split == Split::Train);
    let returns = train.flat_map(|view| view.depth.iter().map(move |depth| (view, depth)));
    returns
        .map(|(view, depth)| {
            let direction = view
                .camera
                .direction(DVec2::from(depth.pixel.map(f64::from)));
            let p = view
                .local_from_camera
                .point(direction * f64::from(depth.range_m));
            p.as_vec3().to_array()
        })
        .collect()
}

fn drive() -> BackgroundInput {
    let eyes: Vec<DVec3> = (0..10)
        .map(|i| DVec3::new(0.3 * f64::from(i), 0.2, 1.5))
        .collect();
    let views: Vec<TrainView> = eyes
        .iter()
        .enumerate()
        .map(|(i, eye)| view(i as u32, look_at(*eye, DVec3::new(9.0, 0.0, 0.6)), false))
        .collect();
    BackgroundInput {
        lidar_points: points(&views),
        views,
        ego_path: eyes,
    }
}

/// Views from one side only, unless `around`.
fn orbit(around: bool, symmetric: bool) -> ObjectInput {
    let views: Vec<TrainView> = (0..15)
        .map(|i| {
            // Held-out views (2, 7, 12 of 15) are on the other side where only one is trained on.
            let side = if !around && i % 5 == 2 { -1.0 } else { 1.0 };
            let turn = if around {
                std::f64::consts::TAU
            } else {
                std::f64::consts::PI
            };
            let angle = side * (0.1 + turn * 0.95 * f64::from(i) / 15.0);
            let eye = DVec3::new(5.0 * libm::cos(angle), 5.0 * libm::sin(angle), 1.2);
            view(i as u32, look_at(eye, DVec3::ZERO), true)
        })
        .collect();
    ObjectInput {
        lidar_points: points(&views),
        views,
        size_m: BOX_HALF * 2.0,
        symmetric,
    }
}

fn quick(mut preset: TrainPreset, steps: u64) -> TrainPreset {
    preset.seconds = 0.0;
    preset.steps = steps;
    preset.most_passes = f64::INFINITY;
    preset.mix.pixel_rays = 1_024;
    preset.mlp_width = 32;
    preset
}

#[test]
fn a_background_is_learned_up_to_its_held_out_views() {
    let mut preset = quick(TrainPreset::background(Budget::Quick), 150);
    preset.box_reach_m = 30.0;
    let trained = train_background(&drive(), &preset, 1, &NoControl).unwrap();
    let quality = trained.quality;
    // Measured 27 dB and 0.04 m; an untrained field is near 10 dB.
    assert!(quality.psnr_held_out.unwrap() > 22.0, "{quality:?}");
    assert!(quality.depth_mae_m.unwrap() < 0.2, "{quality:?}");
    assert_eq!(quality.held_out_frames, [2, 7]);
    assert_eq!((quality.train_views, quality.held_out_views), (8, 2));
    // Sky stays empty.
    let mut samples = Vec::new();
    let up = DVec3::new(0.2, 0.0, 1.0).normalize().as_vec3();
    let tau = trained.field.march(
        glam::Vec3::new(1.0, 0.2, 1.5),
        up,
        0.0,
        50.0,
        9.0,
        &mut samples,
    );
    assert!(tau < 0.1, "{tau}");
}

/// Held-out PSNR of the field as trained and as stored, and the stored bytes.
fn stored(trained: Trained, views: &[TrainView]) -> (f64, f64, usize) {
    let asset = Asset {
        header: AssetHeader {
            format_version: FORMAT_VERSION,
            kind: AssetKind::Object,
            class: ObjectClass::Car,
            size_m: DVec3::ONE,
            symmetric: false,
            usage: Usage::Library,
            usage_reason: String::new(),
            local_from_world: Rigid::IDENTITY,
            source_log: String::new(),
            source_track_id: String::new(),
            synthetic: true,
            quality: trained.quality.clone(),
            coverage: None,
            recording: None,
            valid_region: None,
            ego_from_object: Vec::new(),
            color_space: ColorSpace::Srgb,
            exposure_ev: 0.0,
        },
        field: trained.field,
    };
    let bytes = asset.encode();
    let field = Asset::decode(&bytes).unwrap().field;
    let again = evaluate(&field, views, Run::default(), None);
    let before = trained.quality.psnr_held_out.unwrap();
    (before, again.psnr_held_out.unwrap(), bytes.len())
}

#[test]
fn storing_a_field_costs_under_a_tenth_of_a_decibel() {
    let mut preset = quick(TrainPreset::background(Budget::Quick), 200);
    preset.box_reach_m = 30.0;
    let input = drive();
    let trained = train_background(&input, &preset, 1, &NoControl).unwrap();
    let (before, after, _) = stored(trained, &input.views);
    assert!((before - after).abs() < 0.1, "{before} to {after} dB");
    let mut preset = quick(TrainPreset::object(Budget::Quick), 200);
    preset.voxels_m = vec![0.2, 0.1];
    preset.level_reach_m = vec![f32::INFINITY; 2];
    let input = orbit(true, false);
    let trained = train_object(&input, &preset, 1, &NoControl).unwrap();
    let (before, after, bytes) = stored(trained, &input.views);
    assert!((before - after).abs() < 0.1, "{before} to {after} dB");
    assert!(bytes < 1_000_000, "{bytes} bytes");
}

#[test]
fn an_object_is_learned_and_its_surroundings_stay_empty() {
    let preset = quick(TrainPreset::object(Budget::Quick), 200);
    let quality = train_object(&orbit(true, false), &preset, 1, &NoControl)
        .unwrap()
        .quality;
    // Measured 19.4 dB with views 24 degrees apart and stripes of six pixels.
    assert!(quality.psnr_held_out.unwrap() > 18.0, "{quality:?}");
    assert!(quality.accumulation_in_mask.unwrap() > 0.9, "{quality:?}");
    assert!(quality.halo.unwrap() < 0.1, "{quality:?}");
}

#[test]
fn symmetry_shows_the_side_no_camera_saw() {
    let preset = quick(TrainPreset::object(Budget::Quick), 200);
    let psnr = |symmetric| {
        let input = orbit(false, symmetric);
        train_object(&input, &preset, 1, &NoControl)
            .unwrap()
            .quality
            .psnr_held_out
            .unwrap()
    };
    let (mirrored, plain) = (psnr(true), psnr(false));
    assert!(mirrored > plain + 2.0, "{mirrored} against {plain}");
}

#[test]
fn the_same_seed_gives_the_same_field() {
    let preset = quick(TrainPreset::object(Budget::Quick), 20);
    let train = |seed| {
        train_object(&orbit(true, true), &preset, seed, &NoControl)
            .unwrap()
            .field
    };
    assert_eq!(train(1), train(1));
    assert_ne!(train(1), train(2));
}

/// Cancels before the third step.
#[derive(Default)]
struct StopSoon {
    asked: AtomicU64,
}

impl TrainControl for StopSoon {
    fn progress(&self, progress: Progress) {
        assert!(progress.step <= 2);
    }

    fn cancelled(&self) -> bool {
        self.asked.fetch_add(1, Ordering::Relaxed) >= 2
    }

    fn seconds(&self) -> f64 {
        0.0
    }
}

#[test]
fn a_run_stops_when_asked() {
    let preset = quick(TrainPreset::object(Budget::Quick), 1_000);
    let result = train_object(&orbit(true, false), &preset, 1, &StopSoon::default());
    assert!(matches!(result, Err(Error::Cancelled)), "{result:?}");
}

#[test]
fn divergence_names_step_and_quantity() {
    let mut preset = quick(TrainPreset::object(Budget::Quick), 1_000);
    preset.rates.mlp = f32::INFINITY;
    let result = train_object(&orbit(true, false), &preset, 1, &NoControl);
    assert!(matches!(result, Err(Error::Diverged { .. })), "{result:?}");
}

fn refusal_of(break_it: impl FnOnce(&mut BackgroundInput)) -> String {
    let mut input = drive();
    break_it(&mut input);
    let preset = quick(TrainPreset::background(Budget::Quick), 1);
    match train_background(&input, &preset, 1, &NoControl) {
        Err(error @ Error::Invalid { .. }) => error.to_string(),
        other => panic!("not refused: {:?}", other.map(|t| t.quality)),
    }
}

#[test]
fn bad_input_is_refused_by_frame_and_field_before_any_step() {
    type Case = (&'static str, &'static str, fn(&mut BackgroundInput));
    let cases: [Case; 14] = [
        ("frame 3", "local_from_camera", |i| {
            i.views[3].local_from_camera.translation_m.x = f64::NAN
        }),
        ("frame 4", "focal", |i| i.views[4].camera.focal_px.x = 0.0),
        ("frame 0", "image size", |i| i.views[0].camera.width = 0),
        ("frame 4", "focal", |i| {
            i.views[4].camera.focal_px.y = f64::INFINITY
        }),
        ("frame 4", "singular", |i| {
            i.views[4].camera.focal_px.x = 1e-300
        }),
        ("frame 7", "distortion", |i| {
            i.views[7].camera.distortion = Distortion::BrownConrady {
                k: [0.0, f64::NAN, 0.0, 0.0, 0.0],
            };
        }),
        ("frame 3", "local_from_camera", |i| {
            i.views[3].local_from_camera.rotation = DQuat::from_xyzw(0.0, 0.0, 0.0, 0.0);
        }),
        ("frame 3", "from the local origin", |i| {
            i.views[3].local_from_camera.translation_m.y = 4e6
        }),
        ("no ray is left", "foreground", |i| {
            i.views
                .iter_mut()
                .for_each(|v| v.labels.fill(PixelLabel::Sky));
        }),
        ("frame 5", "labels", |i| i.views[5].labels.truncate(7)),
        ("frame 6", "rgb", |i| i.views[6].rgb.clear()),
        ("frame 1", "depth 0", |i| i.views[1].depth[0].range_m = -1.0),
        ("lidar_points[2]", "not finite", |i| {
            i.lidar_points[2][1] = f32::INFINITY
        }),
        ("no ray is left", "unknown", |i| {
            i.views
                .iter_mut()
                .for_each(|v| v.labels.fill(PixelLabel::Unknown));
        }),
    ];
    for (place, field, break_it) in cases {
        let message = refusal_of(break_it);
        assert!(
            message.contains(place) && message.contains(field),
            "{message}"
        );
    }
    assert!(refusal_of(|i| i.views.clear()).contains("no training view"));
    assert!(refusal_of(|i| i.ego_path.clear()).contains("ego_path"));
}

#[test]
fn a_box_that_no_camera_sees_is_refused() {
    let mut input = orbit(true, false);
    for view in &mut input.views {
        let eye = view.local_from_camera.translation_m;
        view.local_from_camera = look_at(eye, eye * 10.0);
    }
    let preset = quick(TrainPreset::object(Budget::Quick), 1);
    let error = train_object(&input, &preset, 1, &NoControl).unwrap_err();
    assert!(error.to_string().contains("no training camera"), "{error}");
}

#[test]
fn a_field_over_the_memory_bound_is_refused_with_both_figures() {
    let mut preset = quick(TrainPreset::object(Budget::Quick), 1);
    preset.memory_bytes = 10_000;
    let error = train_object(&orbit(true, false), &preset, 1, &NoControl).unwrap_err();
    assert!(
        matches!(
            error,
            Error::OutOfMemory {
                available_bytes: 10_000,
                ..
            }
        ),
        "{error}"
    );
}

#[test]
fn a_preset_that_builds_no_field_is_refused_by_its_entry() {
    type Case = (&'static str, fn(&mut TrainPreset));
    let cases: [Case; 5] = [
        ("voxels_m", |p| p.voxels_m = vec![0.1, f32::NAN]),
        ("level_reach_m", |p| {
            p.level_reach_m.pop();
        }),
        ("mlp_width", |p| p.mlp_width = 33),
        ("pixel_rays", |p| p.mix.pixel_rays = 0),
        ("alpha_init", |p| p.alpha_init = 1.0),
    ];
    for (entry, break_it) in cases {
        let mut preset = quick(TrainPreset::object(Budget::Quick), 1);
        break_it(&mut preset);
        let error = train_object(&orbit(true, false), &preset, 1, &NoControl).unwrap_err();
        assert!(matches!(error, Error::Invalid { .. }), "{error}");
        assert!(error.to_string().contains(entry), "{error}");
    }
}

fn bounded() -> BoundedInput {
    BoundedInput {
        views: orbit(true, false).views,
        low_m: -BOX_HALF * 1.2,
        high_m: BOX_HALF * 1.2,
        backdrop: [0.5, 0.7, 0.9],
    }
}

#[test]
fn bad_bounded_input_is_refused_by_frame_and_field() {
    type Case = (&'static str, &'static str, fn(&mut BoundedInput));
    let cases: [Case; 9] = [
        ("scene", "the box from", |i| i.low_m.x = f64::NAN),
        ("scene", "the box from", |i| i.high_m.z = i.low_m.z),
        ("scene", "no training camera sees", |i| {
            i.low_m.z += 500.0;
            i.high_m.z += 500.0;
        }),
        ("scene", "backdrop", |i| i.backdrop[1] = f32::NAN),
        ("scene", "no training view", |i| i.views.clear()),
        ("frame 3", "local_from_camera", |i| {
            i.views[3].local_from_camera.translation_m.z = f64::INFINITY
        }),
        ("frame 0", "image size", |i| i.views[0].camera.height = 0),
        ("frame 6", "labels", |i| i.views[6].labels.truncate(5)),
        ("no ray is left", "unknown", |i| {
            i.views
                .iter_mut()
                .for_each(|v| v.labels.fill(PixelLabel::Unknown));
        }),
    ];
    for (place, field, break_it) in cases {
        let mut input = bounded();
        break_it(&mut input);
        let error = train_bounded(&input, &TrainPreset::fast(3.0, 0.05), 1, &NoControl)
            .map(|t| t.quality)
            .unwrap_err();
        assert!(matches!(error, Error::Invalid { .. }), "{error}");
        let message = error.to_string();
        assert!(
            message.contains(place) && message.contains(field),
            "{message}"
        );
    }
    let mut preset = TrainPreset::fast(3.0, 0.05);
    preset.memory_bytes = 1_000;
    let error = train_bounded(&bounded(), &preset, 1, &NoControl).unwrap_err();
    assert!(matches!(error, Error::OutOfMemory { .. }), "{error}");
}

#[test]
fn bad_objects_are_refused_by_field() {
    type Case = (&'static str, fn(&mut ObjectInput));
    let cases: [Case; 5] = [
        ("size_m", |i| i.size_m.y = f64::NAN),
        ("size_m", |i| i.size_m.z = 0.0),
        ("lidar_points[1]", |i| i.lidar_points[1][2] = f32::NAN),
        ("foreground", |i| {
            let views = i.views.iter_mut();
            views.for_each(|v| v.labels.fill(PixelLabel::Background));
        }),
        ("no training view", |i| {
            let views = i.views.iter_mut();
            views.for_each(|v| v.split = Split::HeldOut);
        }),
    ];
    for (field, break_it) in cases {
        let mut input = orbit(true, false);
        break_it(&mut input);
        let preset = quick(TrainPreset::object(Budget::Quick), 1);
        let error = train_object(&input, &preset, 1, &NoControl).unwrap_err();
        assert!(matches!(error, Error::Invalid { .. }), "{error}");
        assert!(error.to_string().contains(field), "{error}");
    }
}

#[test]
fn the_papers_dense_background_stores_its_whole_box_and_learns() {
    let mut preset = quick(TrainPreset::paper_background(), 40);
    preset.box_reach_m = 6.0;
    preset.mix.pixel_rays = 512;
    preset.mix.depth_rays = 128;
    let trained = train_background(&drive(), &preset, 1, &NoControl).unwrap();
    assert_eq!(trained.field.levels().len(), 1);
    assert_eq!(trained.quality.voxel_size_m, 0.25);
    // Measured 21 dB; an untrained field is near 10 dB.
    assert!(
        trained.quality.psnr_held_out.unwrap() > 16.0,
        "{:?}",
        trained.quality
    );
    preset.memory_bytes = 1 << 20;
    let error = train_background(&drive(), &preset, 1, &NoControl).unwrap_err();
    assert!(matches!(error, Error::OutOfMemory { .. }), "{error}");
}
