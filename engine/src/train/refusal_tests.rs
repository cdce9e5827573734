//! What cannot be trained on is refused before any step, by frame and field.

use glam::DQuat;

use super::tests::{BOX_HALF, drive, look_at, orbit, quick};
use super::*;
use crate::Error;
use crate::backend::cpu::CpuBackend;
use crate::camera::Distortion;
use crate::view::{PixelLabel, Split};

const BEAM: LidarBeam = LidarBeam {
    origin_m: [0.0, 0.0, 1.8],
    return_m: [9.0, 0.0, 0.0],
    view: 0,
};

fn refusal_of(break_it: impl FnOnce(&mut BackgroundInput)) -> String {
    let mut input = drive();
    break_it(&mut input);
    let preset = quick(TrainPreset::background(Budget::Quick), 1);
    match train_background(&input, &preset, 1, &CpuBackend, &NoControl) {
        Err(error @ Error::Invalid { .. }) => error.to_string(),
        other => panic!("not refused: {:?}", other.map(|t| t.quality)),
    }
}

#[test]
fn bad_input_is_refused_by_frame_and_field_before_any_step() {
    type Case = (&'static str, &'static str, fn(&mut BackgroundInput));
    let cases: [Case; 17] = [
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
        ("frame 1", "has weight NaN", |i| {
            i.views[1].depth[0].weight = f32::NAN
        }),
        ("beams[1]", "different ends", |i| {
            i.beams = vec![BEAM; 2];
            i.beams[1].return_m = BEAM.origin_m;
        }),
        ("beams[0]", "index of a view", |i| {
            i.beams = vec![LidarBeam { view: 10, ..BEAM }];
        }),
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
    let error = train_object(&input, &preset, 1, &CpuBackend, &NoControl).unwrap_err();
    assert!(error.to_string().contains("no training camera"), "{error}");
}

#[test]
fn a_field_over_the_memory_bound_is_refused_with_both_figures() {
    let mut preset = quick(TrainPreset::object(Budget::Quick), 1);
    preset.memory_bytes = 10_000;
    let error = train_object(&orbit(true, false), &preset, 1, &CpuBackend, &NoControl).unwrap_err();
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
        let error =
            train_object(&orbit(true, false), &preset, 1, &CpuBackend, &NoControl).unwrap_err();
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
        let fast = train_bounded(
            &input,
            &TrainPreset::fast(3.0, 0.05),
            1,
            &CpuBackend,
            &NoControl,
        );
        let recipe = train_dvgo(&input, &DvgoRecipe::scaled(1), 1, &CpuBackend, &NoControl);
        for trained in [fast, recipe] {
            let error = trained.map(|t| t.quality).unwrap_err();
            assert!(matches!(error, Error::Invalid { .. }), "{error}");
            let message = error.to_string();
            assert!(
                message.contains(place) && message.contains(field),
                "{message}"
            );
        }
    }
    let mut preset = TrainPreset::fast(3.0, 0.05);
    preset.memory_bytes = 1_000;
    let error = train_bounded(&bounded(), &preset, 1, &CpuBackend, &NoControl).unwrap_err();
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
        let error = train_object(&input, &preset, 1, &CpuBackend, &NoControl).unwrap_err();
        assert!(matches!(error, Error::Invalid { .. }), "{error}");
        assert!(error.to_string().contains(field), "{error}");
    }
}
