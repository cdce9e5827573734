//! Training on scenes small enough to trace by hand.

use std::sync::atomic::{AtomicU64, Ordering};

use glam::{DMat3, DQuat, DVec2, DVec3};

use super::evaluate::evaluate;
use super::fit::Run;
use super::*;
use crate::asset::{AssetHeader, AssetKind, ColorSpace, FORMAT_VERSION, Usage};
use crate::backend::cpu::CpuBackend;
use crate::camera::{Camera, Distortion, Rigid};
use crate::class::ObjectClass;
use crate::field::DensityActivation;
use crate::view::{DepthReturn, PixelLabel, Split, TrainView};
use crate::{Asset, Error};

/// Ground z = 0 with a checkerboard, and a striped box of these half extents around this centre; sky above.
pub(super) const BOX_HALF: DVec3 = DVec3::new(1.0, 0.6, 0.5);
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
pub(super) fn look_at(eye: DVec3, target: DVec3) -> Rigid {
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
                view.depth.push(DepthReturn::lidar(pixel, t as f32));
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

pub(crate) fn drive() -> BackgroundInput {
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
        beams: Vec::new(),
        ego_path: eyes,
    }
}

/// Views from one side only, unless `around`.
pub(crate) fn orbit(around: bool, symmetric: bool) -> ObjectInput {
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

pub(crate) fn quick(mut preset: TrainPreset, steps: u64) -> TrainPreset {
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
    let trained = train_background(&drive(), &preset, 1, &CpuBackend, &NoControl).unwrap();
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

#[test]
fn a_mean_over_the_end_is_better_than_the_last_step_at_constant_rates() {
    let psnr = |average_last| {
        let mut preset = quick(TrainPreset::background(Budget::Standard), 400);
        preset.box_reach_m = 30.0;
        // The last survey falls among the moments.
        preset.surveys = Surveys::AtSteps(vec![40, 324]);
        preset.rate_decay = 1.0;
        preset.options.average_last = average_last;
        let trained = train_background(&drive(), &preset, 1, &CpuBackend, &NoControl).unwrap();
        trained.quality.psnr_held_out.unwrap()
    };
    let (last, mean) = (psnr(0.0), psnr(0.2));
    // Measured 0.23 dB.
    assert!(mean > last + 0.1, "{mean} dB, {last} dB without");
}

#[test]
fn untouched_space_is_coloured_at_first_and_not_later() {
    for budget in [Budget::Quick, Budget::Standard] {
        let preset = TrainPreset::background(budget);
        let finest = *preset.voxels_m.last().unwrap();
        let sigma = DensityActivation::from_alpha(preset.alpha_init, finest).sigma(0.0);
        let weight = 1.0 - (-sigma * preset.voxels_m[0]).exp();
        let least = |done| preset.options.min_weight(done).unwrap();
        assert!(weight > 2.0 * least(0.0) && weight < least(0.5), "{weight}");
    }
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
        field: trained.field.into(),
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
    let trained = train_background(&input, &preset, 1, &CpuBackend, &NoControl).unwrap();
    let (before, after, _) = stored(trained, &input.views);
    assert!((before - after).abs() < 0.1, "{before} to {after} dB");
    let mut preset = quick(TrainPreset::object(Budget::Quick), 200);
    preset.voxels_m = vec![0.2, 0.1];
    preset.level_reach_m = vec![f32::INFINITY; 2];
    let input = orbit(true, false);
    let trained = train_object(&input, &preset, 1, &CpuBackend, &NoControl).unwrap();
    let (before, after, bytes) = stored(trained, &input.views);
    assert!((before - after).abs() < 0.1, "{before} to {after} dB");
    assert!(bytes < 1_000_000, "{bytes} bytes");
}

#[test]
fn an_object_is_learned_and_its_surroundings_stay_empty() {
    let preset = quick(TrainPreset::object(Budget::Quick), 200);
    let quality = train_object(&orbit(true, false), &preset, 1, &CpuBackend, &NoControl)
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
        train_object(&input, &preset, 1, &CpuBackend, &NoControl)
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
        train_object(&orbit(true, true), &preset, seed, &CpuBackend, &NoControl)
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
    let result = train_object(
        &orbit(true, false),
        &preset,
        1,
        &CpuBackend,
        &StopSoon::default(),
    );
    assert!(matches!(result, Err(Error::Cancelled)), "{result:?}");
}

#[test]
fn divergence_names_step_and_quantity() {
    let mut preset = quick(TrainPreset::object(Budget::Quick), 1_000);
    preset.rates.mlp = f32::INFINITY;
    let result = train_object(&orbit(true, false), &preset, 1, &CpuBackend, &NoControl);
    assert!(matches!(result, Err(Error::Diverged { .. })), "{result:?}");
}

#[test]
fn the_papers_dense_background_stores_its_whole_box_and_learns() {
    let mut preset = quick(TrainPreset::paper_background(), 40);
    preset.box_reach_m = 6.0;
    preset.mix.pixel_rays = 512;
    preset.mix.depth_rays = 128;
    let trained = train_background(&drive(), &preset, 1, &CpuBackend, &NoControl).unwrap();
    assert_eq!(trained.field.levels().len(), 1);
    assert_eq!(trained.quality.voxel_size_m, 0.25);
    // Measured 21 dB; an untrained field is near 10 dB.
    assert!(
        trained.quality.psnr_held_out.unwrap() > 16.0,
        "{:?}",
        trained.quality
    );
    preset.memory_bytes = 1 << 20;
    let error = train_background(&drive(), &preset, 1, &CpuBackend, &NoControl).unwrap_err();
    assert!(matches!(error, Error::OutOfMemory { .. }), "{error}");
}
