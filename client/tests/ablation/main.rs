//! What parts of the method are for, on a generated log: it is decomposed as a job would, a part is taken away, and the figure it is
//! for gets worse. `engine/tests/ablation` does the same on a scene traced by hand, and more of it.
//!
//! `cargo test -p backlot-client --test ablation -- --nocapture` prints the figures of docs/method.md.

mod subject;

use backlot_engine::Field;
use backlot_engine::backend::cpu::CpuBackend;
use backlot_engine::quality::SilhouetteFigures;
use backlot_engine::train::ray::{DepthForm, Rectified};
use backlot_engine::train::{
    Budget, NoControl, ObjectInput, TrainPreset, train_background, train_object,
};
use backlot_server::ingest::{LogLabels, background_set};

use subject::{decoded, street, subject};

/// Fixed, so that a failure is no chance.
const SEED: u64 = 7;

/// How long everything trains.
const STEPS: u64 = 180;
const RAYS: usize = 768;

fn object_preset() -> TrainPreset {
    let mut preset = TrainPreset::object(Budget::Standard);
    preset.voxels_m = vec![0.4, 0.1];
    preset.level_reach_m = vec![f32::INFINITY; 2];
    preset.mlp_width = 32;
    preset.steps = STEPS;
    preset.most_passes = f64::INFINITY;
    preset.mix.pixel_rays = RAYS;
    preset
}

fn fit(input: &ObjectInput, preset: &TrainPreset) -> Field {
    let trained = train_object(input, preset, SEED, &CpuBackend, &NoControl);
    trained.expect("the set is sound").field
}

/// Colour loss alone, cross-entropy, and the printed loss.
fn rectified() -> [SilhouetteFigures; 3] {
    let mut subject = subject();
    subject.input.symmetric = false;
    let views = subject.seen_side();
    let run = |weight: f32, form: Rectified| {
        let mut preset = object_preset();
        preset.mix.silhouette_weight = weight;
        preset.losses.rectified = form;
        SilhouetteFigures::of(&fit(&subject.input, &preset), &views)
    };
    let weight = object_preset().mix.silhouette_weight;
    [
        run(0.0, Rectified::CrossEntropy),
        run(weight, Rectified::CrossEntropy),
        run(weight, Rectified::Printed),
    ]
}

/// On the side that no frame shows, without and with the mirror.
fn symmetry() -> [SilhouetteFigures; 2] {
    let mut subject = subject();
    let views = subject.unseen_side();
    [false, true].map(|symmetric| {
        subject.input.symmetric = symmetric;
        let field = fit(&subject.input, &object_preset());
        SilhouetteFigures::of(&field, &views)
    })
}

/// PSNR and depth error on the background's held-out frames: without depth supervision, with it, and with the paper's.
fn depth() -> [(f64, f64); 3] {
    let log = street().read_log().expect("the street can be recorded");
    let drive_log = decoded(&log);
    let labels = LogLabels::default();
    let set = background_set(&drive_log, &log, &labels, 5, u32::MAX, |_, _| true);
    let input = set.expect("frames load").expect("nothing stops it").input;
    let run = |weight: f32, form: DepthForm| {
        let mut preset = TrainPreset::background(Budget::Standard);
        preset.voxels_m = vec![1.6, 0.4];
        preset.level_reach_m = vec![f32::INFINITY; 2];
        preset.box_reach_m = 60.0;
        preset.mlp_width = 32;
        preset.steps = STEPS;
        preset.most_passes = f64::INFINITY;
        preset.mix.pixel_rays = RAYS;
        preset.mix.depth_rays = RAYS / 4;
        preset.mix.depth_weight = weight;
        // Pulses' free space is depth supervision too.
        preset.mix.beam_weight *= f32::from(u8::from(weight > 0.0));
        preset.losses.depth = form;
        let trained = train_background(&input, &preset, SEED, &CpuBackend, &NoControl);
        let quality = trained.expect("the set is sound").quality;
        let figure = |x: Option<f64>| x.expect("frames were held out");
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
fn cross_entropy_lowers_the_halo_of_bad_masks_and_the_printed_loss_does_not() {
    let [color, entropy, printed] = rectified();
    eprintln!("colour {color:?}\ncross-entropy {entropy:?}\nprinted {printed:?}");
    assert!(entropy.halo < 0.7 * color.halo, "{entropy:?} {color:?}");
    assert!(printed.halo > 0.95 * color.halo, "{printed:?} {color:?}");
    // The car is not paid for it.
    assert!(entropy.opacity > 0.9, "{entropy:?}");
}

#[test]
fn symmetry_shows_the_unseen_side() {
    let [plain, mirrored] = symmetry();
    eprintln!("plain {plain:?}\nmirrored {mirrored:?}");
    assert!(mirrored.psnr > plain.psnr + 3.0, "{mirrored:?} {plain:?}");
}

#[test]
fn depth_supervision_lowers_the_depth_error() {
    let [without, with, paper] = depth();
    eprintln!("without {without:?}\nwith {with:?}\nL1 of the composited range {paper:?}");
    assert!(with.1 < 0.8 * without.1, "{with:?} {without:?}");
}
