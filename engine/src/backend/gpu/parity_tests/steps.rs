//! Parity of optimiser steps.

use super::adapter::on_adapter;
use super::stage_compare::relative_error;
use crate::backend::cpu::tests::{LOSSES, field, rays_of_all_sorts};
use crate::backend::cpu::{CpuTrainer, Simd};
use crate::backend::gpu::GpuBackend;
use crate::field::Field;
use crate::train::ray::{Rates, RayLosses};

const RATES: Rates = Rates {
    density: 0.02,
    features: 0.02,
    mlp: 2e-3,
    sky: 0.05,
    exposure: 0.0,
    pose_m: 0.0,
};
/// Relative error of what a kind of parameters moved by. An optimiser divides by the gradient's own size, so that a node whose
/// gradient is rounding only moves as far as others, either way. Measured 2e-6 on lavapipe; fused multiply-add elsewhere tips more signs.
const MOVED: f64 = 1e-2;
const STEPS: usize = 5;

#[test]
fn parity_of_five_steps() {
    on_adapter("five steps", |gpu| {
        let before = parameters(&field());
        let device = parameters(&on_gpu(gpu, &LOSSES, RATES));
        let errors = errors(&before, &device, &parameters(&on_cpu(&LOSSES, RATES)));
        println!("relative errors of density, features, network, sky: {errors:?}");
        assert!(errors.iter().all(|e| *e < MOVED), "{errors:?}");
        for rates in off_by_a_tenth() {
            let other = parameters(&on_cpu(&LOSSES, rates));
            let verdict = self::errors(&before, &device, &other);
            assert!(verdict.iter().any(|e| *e > MOVED), "{rates:?}: {verdict:?}");
        }
    });
}

fn off_by_a_tenth() -> [Rates; 4] {
    let mut all = [RATES; 4];
    all[0].density *= 1.1;
    all[1].features *= 1.1;
    all[2].mlp *= 1.1;
    all[3].sky *= 1.1;
    all
}

fn on_gpu(gpu: &GpuBackend, losses: &RayLosses, rates: Rates) -> Field {
    let mut trainer = gpu.open_trainer(field()).unwrap();
    let rays = rays_of_all_sorts(100);
    for _ in 0..STEPS {
        trainer.step(&rays, losses, rates, 0.0, &|| false).unwrap();
    }
    trainer.fetch().unwrap();
    trainer.into_field()
}

fn on_cpu(losses: &RayLosses, rates: Rates) -> Field {
    let mut trainer = CpuTrainer::new(field(), Simd::Baseline);
    let rays = rays_of_all_sorts(100);
    for _ in 0..STEPS {
        trainer.step(&rays, losses, rates);
    }
    trainer.into_field()
}

/// Densities, features, network and sky.
fn parameters(field: &Field) -> [Vec<f32>; 4] {
    let levels = || field.levels().iter();
    let sky = field.sky.as_ref().expect("the field has a sky");
    let logits = sky
        .grids()
        .iter()
        .flat_map(|grid| grid.logits().as_flattened());
    [
        levels()
            .flat_map(|level| level.density())
            .copied()
            .collect(),
        levels()
            .flat_map(|level| level.features().as_flattened())
            .copied()
            .collect(),
        field.mlp().parameters().to_vec(),
        logits.copied().collect(),
    ]
}

/// Relative errors of what each kind of parameters moved by.
fn errors(before: &[Vec<f32>; 4], gpu: &[Vec<f32>; 4], cpu: &[Vec<f32>; 4]) -> [f64; 4] {
    let moved = |after: &[f32], before: &[f32]| -> Vec<f32> {
        after.iter().zip(before).map(|(a, b)| a - b).collect()
    };
    std::array::from_fn(|kind| {
        let device = moved(&gpu[kind], &before[kind]);
        relative_error(&device, &moved(&cpu[kind], &before[kind]))
    })
}
