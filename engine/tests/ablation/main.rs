//! What each part of the method is for: it is taken away, and the figure it is for gets worse.
//!
//! The short forms run with every test. The long forms, whose figures are in docs/method.md:
//! `cargo test --release -p backlot-engine --test ablation -- --ignored --nocapture --test-threads 1`

mod scene;

use backlot_engine::Field;
use backlot_engine::backend::cpu::CpuBackend;
use backlot_engine::quality::SilhouetteFigures;
use backlot_engine::train::ray::{DepthForm, Rectified};
use backlot_engine::train::{
    Budget, NoControl, ObjectInput, TrainPreset, train_background, train_object,
};

/// Fixed, so that a failure is no chance.
const SEED: u64 = 7;

/// How long the ablations train, and on how many views.
#[derive(Clone, Copy)]
struct Scale {
    views: u32,
    steps: u64,
    rays: usize,
}

const SHORT: Scale = Scale {
    views: 20,
    steps: 180,
    rays: 768,
};
const LONG: Scale = Scale {
    views: 30,
    steps: 800,
    rays: 1_024,
};

fn object_preset(scale: Scale) -> TrainPreset {
    let mut preset = TrainPreset::object(Budget::Standard);
    preset.voxels_m = vec![0.4, 0.1];
    preset.level_reach_m = vec![f32::INFINITY; 2];
    preset.mlp_width = 32;
    preset.steps = scale.steps;
    preset.most_passes = f64::INFINITY;
    preset.mix.pixel_rays = scale.rays;
    preset
}

fn fit(input: &ObjectInput, preset: &TrainPreset, seed: u64) -> Field {
    train_object(input, preset, seed, &CpuBackend, &NoControl)
        .expect("the scene is sound")
        .field
}

/// SilhouetteFigures of colour loss alone, cross-entropy, and the printed loss, on views of the side that was seen.
fn rectified(scale: Scale, seed: u64) -> [SilhouetteFigures; 3] {
    let input = scene::one_sided(scale.views, false, true);
    let views = scene::unseen(false);
    let run = |weight: f32, form: Rectified| {
        let mut preset = object_preset(scale);
        preset.mix.silhouette_weight = weight;
        preset.losses.rectified = form;
        SilhouetteFigures::of(&fit(&input, &preset, seed), &views)
    };
    let weight = object_preset(scale).mix.silhouette_weight;
    [
        run(0.0, Rectified::CrossEntropy),
        run(weight, Rectified::CrossEntropy),
        run(weight, Rectified::Printed),
    ]
}

#[test]
fn cross_entropy_lowers_the_halo_of_bad_masks_and_the_printed_loss_does_not() {
    let [color, entropy, printed] = rectified(SHORT, SEED);
    eprintln!("colour {color:?}\ncross-entropy {entropy:?}\nprinted {printed:?}");
    assert!(entropy.halo < 0.7 * color.halo, "{entropy:?} {color:?}");
    assert!(printed.halo > 0.95 * color.halo, "{printed:?} {color:?}");
    // The car is not paid for it.
    assert!(entropy.opacity > 0.9, "{entropy:?}");
}

/// SilhouetteFigures on the side that no camera saw, without and with the mirror.
fn symmetry(scale: Scale, seed: u64) -> [SilhouetteFigures; 2] {
    let views = scene::unseen(true);
    [false, true].map(|symmetric| {
        let input = scene::one_sided(scale.views, symmetric, true);
        SilhouetteFigures::of(&fit(&input, &object_preset(scale), seed), &views)
    })
}

#[test]
fn symmetry_shows_the_unseen_side() {
    let [plain, mirrored] = symmetry(SHORT, SEED);
    eprintln!("plain {plain:?}\nmirrored {mirrored:?}");
    assert!(mirrored.psnr > plain.psnr + 3.0, "{mirrored:?} {plain:?}");
}

fn background_preset(scale: Scale) -> TrainPreset {
    let mut preset = TrainPreset::background(Budget::Standard);
    preset.voxels_m = vec![1.6, 0.4];
    preset.level_reach_m = vec![f32::INFINITY; 2];
    preset.box_reach_m = 20.0;
    preset.mlp_width = 32;
    preset.steps = scale.steps;
    preset.most_passes = f64::INFINITY;
    preset.mix.pixel_rays = scale.rays;
    preset.mix.depth_rays = scale.rays / 4;
    preset
}

/// PSNR and depth error on held-out views of a drive: without depth supervision, with it, and with the paper's.
fn depth(scale: Scale, seed: u64) -> [(f64, f64); 3] {
    let input = scene::drive(scale.views);
    let run = |weight: f32, form: DepthForm| {
        let mut preset = background_preset(scale);
        preset.mix.depth_weight = weight;
        preset.losses.depth = form;
        let trained = train_background(&input, &preset, seed, &CpuBackend, &NoControl);
        let quality = trained.expect("the scene is sound").quality;
        let figure = |x: Option<f64>| x.expect("views were held out");
        (figure(quality.psnr_held_out), figure(quality.depth_mae_m))
    };
    let weight = TrainPreset::background(Budget::Standard).mix.depth_weight;
    [
        run(0.0, DepthForm::Expected),
        run(weight, DepthForm::Expected),
        run(1.0, DepthForm::CompositedL1),
    ]
}

#[test]
fn depth_supervision_lowers_the_depth_error() {
    let scale = Scale {
        steps: 120,
        ..SHORT
    };
    let [without, with, paper] = depth(scale, SEED);
    eprintln!("without {without:?}\nwith {with:?}\nL1 of the composited range {paper:?}");
    assert!(with.1 < 0.8 * without.1, "{with:?} {without:?}");
}

/// Held-out PSNR on unevenly exposed training views, without and with per-view exposure.
fn exposure(scale: Scale, seed: u64) -> [f64; 2] {
    let input = scene::with_uneven_exposure(scene::drive(scale.views));
    [0.0, 0.005].map(|rate| {
        let mut preset = background_preset(scale);
        preset.rates.exposure = rate;
        let trained = train_background(&input, &preset, seed, &CpuBackend, &NoControl);
        let quality = trained.expect("the scene is sound").quality;
        quality.psnr_held_out.expect("views were held out")
    })
}

#[test]
fn per_view_exposure_recovers_uneven_exposure() {
    let scale = Scale {
        steps: 150,
        ..SHORT
    };
    let [without, with] = exposure(scale, SEED);
    eprintln!("exposure: without {without:.2} dB, with {with:.2} dB");
    assert!(with > without + 0.15, "{with} {without}");
}

/// SilhouetteFigures on true poses after training on jittered ones, without and with pose refinement.
fn poses(scale: Scale, seed: u64) -> [SilhouetteFigures; 2] {
    let input = scene::with_pose_jitter(scene::one_sided(scale.views, false, false));
    let views = scene::unseen(false);
    [0.0, 0.002].map(|rate| {
        let mut preset = object_preset(scale);
        preset.rates.pose_m = rate;
        preset.options.poses_from = 0.1;
        SilhouetteFigures::of(&fit(&input, &preset, seed), &views)
    })
}

#[test]
fn pose_refinement_sharpens_an_object_with_jittered_cuboids() {
    let [without, with] = poses(SHORT, SEED);
    eprintln!("poses: without {without:?}\n  with {with:?}");
    assert!(with.psnr > without.psnr + 0.3, "{with:?} {without:?}");
}

const SEEDS: [u64; 3] = [7, 8, 9];

#[test]
#[ignore = "minutes; prints the figures of docs/method.md"]
fn long_rectified() {
    for seed in SEEDS {
        let [color, entropy, printed] = rectified(LONG, seed);
        eprintln!(
            "seed {seed}\n  colour {color:?}\n  cross-entropy {entropy:?}\n  printed {printed:?}"
        );
        assert!(entropy.halo < 0.7 * color.halo && printed.halo > 0.95 * color.halo);
    }
}

#[test]
#[ignore = "minutes; prints the figures of docs/method.md"]
fn long_symmetry() {
    for seed in SEEDS {
        let [plain, mirrored] = symmetry(LONG, seed);
        eprintln!("seed {seed}\n  plain {plain:?}\n  mirrored {mirrored:?}");
        assert!(mirrored.psnr > plain.psnr + 3.0);
    }
}

#[test]
#[ignore = "minutes; prints the figures of docs/method.md"]
fn long_depth() {
    for seed in SEEDS {
        let [without, with, paper] = depth(LONG, seed);
        eprintln!("seed {seed}\n  without {without:?}\n  with {with:?}\n  composited L1 {paper:?}");
        assert!(with.1 < 0.8 * without.1 && with.1 < paper.1);
    }
}

#[test]
#[ignore = "minutes; prints the figures of docs/method.md"]
fn long_corrections() {
    for seed in SEEDS {
        let [plain, exposed] = exposure(LONG, seed);
        let [jittered, refined] = poses(LONG, seed);
        eprintln!("seed {seed}\n  exposure: without {plain:.2} dB, with {exposed:.2} dB");
        eprintln!("  poses: without {jittered:?}\n  with {refined:?}");
        assert!(exposed > plain && refined.psnr > jittered.psnr);
    }
}
