//! Parity of whole training runs.

use std::sync::Arc;

use super::adapter::on_adapter;
use crate::Result;
use crate::backend::cpu::{CpuBackend, CpuTrainer, Simd};
use crate::backend::{Backend, GridDevice, LoadedField, Trainer};
use crate::field::Field;
use crate::scene::{RenderOptions, RenderedFrame, Scene};
use crate::train::tests::{drive, orbit, quick};
use crate::train::{Budget, NoControl, TrainPreset, train_background, train_object};

const STEPS: u64 = 50;
/// What rounding, reordered sums and the decisions they tip may cost after fifty steps.
pub(super) const PSNR_DB: f64 = 0.1;

/// The CPU's path without fused multiply-add, in f32.
#[derive(Debug)]
pub(super) struct Unfused;

impl Backend for Unfused {
    fn name(&self) -> &'static str {
        "cpu"
    }

    fn device(&self) -> String {
        "the oracle".to_owned()
    }

    fn load(&self, field: &Arc<Field>) -> Result<Box<dyn LoadedField>> {
        CpuBackend.load(field)
    }

    fn trainer(&self, field: Field, _: &dyn Fn() -> bool) -> Result<Trainer> {
        Ok(Trainer::on_cpu(CpuTrainer::new(field, Simd::Baseline)))
    }

    fn grid_device(&self) -> Result<GridDevice> {
        Ok(GridDevice::cpu_in_f32(Simd::Baseline))
    }

    fn render(
        &self,
        scene: &Scene<'_>,
        options: &RenderOptions,
        cancelled: &(dyn Fn() -> bool + Sync),
    ) -> Result<RenderedFrame> {
        CpuBackend.render(scene, options, cancelled)
    }
}

/// Asserts that both sides end alike, and that a run of half as many steps does not.
fn agree(name: &str, psnr: impl Fn(&dyn Backend, u64) -> f64) {
    on_adapter(name, |gpu| {
        let device = psnr(gpu, STEPS);
        let host = psnr(&Unfused, STEPS);
        println!("{name}: {device:.3} dB on the device, {host:.3} dB on the processor");
        assert!(
            (device - host).abs() < PSNR_DB,
            "{device} against {host} dB"
        );
        let shorter = psnr(&Unfused, STEPS / 2);
        assert!(
            (device - shorter).abs() > PSNR_DB,
            "half a run passes: {device} against {shorter} dB"
        );
    });
}

fn background_psnr(backend: &dyn Backend, steps: u64, average_last: f64) -> f64 {
    let mut preset = quick(TrainPreset::background(Budget::Quick), steps);
    preset.box_reach_m = 10.0;
    preset.mix.pixel_rays = 256;
    preset.mix.depth_rays = 64;
    preset.mlp_width = 16;
    preset.losses.density_variation = 1e-3;
    preset.options.average_last = average_last;
    let trained = train_background(&drive(), &preset, 1, backend, &NoControl).unwrap();
    trained.quality.psnr_held_out.unwrap()
}

#[test]
fn parity_of_fifty_steps_of_a_background() {
    agree("fifty steps of a background", |backend, steps| {
        background_psnr(backend, steps, 0.0)
    });
}

#[test]
fn parity_of_a_mean_over_most_of_fifty_steps() {
    agree("a mean over most of fifty steps", |backend, steps| {
        background_psnr(backend, steps, 0.8)
    });
    // A device that takes the last step instead would be noticed.
    let host = |average_last| background_psnr(&Unfused, STEPS, average_last);
    let (mean, last) = (host(0.8), host(0.0));
    assert!((mean - last).abs() > PSNR_DB, "{mean} and {last} dB");
}

#[test]
fn parity_of_fifty_steps_of_an_object() {
    agree("fifty steps of an object", |backend, steps| {
        let mut preset = quick(TrainPreset::object(Budget::Quick), steps);
        preset.voxels_m = vec![0.2, 0.1];
        preset.level_reach_m = vec![f32::INFINITY; 2];
        preset.mix.pixel_rays = 256;
        preset.mix.depth_rays = 64;
        preset.mlp_width = 16;
        let trained = train_object(&orbit(true, false), &preset, 1, backend, &NoControl).unwrap();
        trained.quality.psnr_held_out.unwrap()
    });
}
