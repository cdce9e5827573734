//! Parity of what is said and kept when training diverges.

use super::adapter::on_adapter;
use crate::Error;
use crate::backend::Trainer;
use crate::backend::cpu::tests::{LOSSES, field, rays_of_all_sorts};
use crate::backend::cpu::{CpuTrainer, Simd};
use crate::field::Field;
use crate::train::ray::{Rates, TrainRay};

const RATES: Rates = Rates {
    density: 0.02,
    features: 0.02,
    mlp: 2e-3,
    sky: 0.05,
    exposure: 0.01,
    pose_m: 1e-3,
};
const STEPS: u64 = 12;

/// What makes a step's sums infinite or NaN.
type Poison = fn(&mut TrainRay);

const COLOR: Poison = |ray| ray.color[1] = f32::NAN;
const RANGE: Poison = |ray| {
    ray.range_weight = f32::INFINITY;
    ray.range_m = 2.0;
};

/// The step and quantity that a trainer names.
fn diverged(trainer: Trainer, poisoned: u64, poison: Poison) -> (u64, &'static str) {
    match run(trainer, poisoned, poison) {
        Err(Error::Diverged { step, quantity }) => (step, quantity),
        other => panic!("{other:?}"),
    }
}

fn run(mut trainer: Trainer, poisoned: u64, poison: Poison) -> crate::Result<Field> {
    let rays = rays_of_all_sorts(60);
    for step in 0..STEPS {
        let mut rays = rays.clone();
        if step == poisoned {
            poison(&mut rays[4]);
        }
        trainer.step(&rays, &LOSSES, RATES, &|| false)?;
    }
    trainer.into_field(&|| false)
}

fn on_cpu() -> Trainer {
    Trainer::on_cpu(CpuTrainer::new(field(), Simd::Baseline))
}

#[test]
fn parity_of_the_step_and_quantity_that_diverged() {
    on_adapter("divergence", |gpu| {
        for (poison, expected) in [(COLOR, "colour"), (RANGE, "loss")] {
            // One that is asked about at once, and one whose sums others have followed by then.
            for step in [3, 8] {
                let on_gpu = || Trainer::on_gpu(gpu.open_trainer(field(), &|| false).unwrap());
                let device = diverged(on_gpu(), step, poison);
                assert_eq!(device, (step, expected));
                assert_eq!(device, diverged(on_cpu(), step, poison));
                let other = diverged(on_cpu(), step + 1, poison);
                assert_ne!(device, other, "a later step passes");
            }
        }
    });
}

#[test]
fn parity_of_a_field_that_diverged_nothing_of_which_moves_from_then_on() {
    on_adapter("diverged field", |gpu| {
        let rays = rays_of_all_sorts(60);
        let mut poisoned = rays.clone();
        COLOR(&mut poisoned[4]);
        let mut trainer = gpu.open_trainer(field(), &|| false).unwrap();
        let mut fetched = Vec::new();
        for rays in [&rays, &poisoned, &rays] {
            trainer.step(rays, &LOSSES, RATES, 0.0, &|| false).unwrap();
            trainer.fetch(&|| false).unwrap();
            fetched.push((trainer.field().clone(), trainer.view_corrections().unwrap()));
        }
        assert_ne!(fetched[0].0, field(), "a sound step moves something");
        assert_eq!(fetched[0].0, fetched[1].0);
        assert_eq!(fetched[0].0, fetched[2].0);
        let finite = |field: &Field| {
            let mut densities = field.levels().iter().flat_map(|level| level.density());
            densities.all(|d| d.is_finite())
        };
        assert!(finite(&fetched[2].0));
        assert_eq!(trainer.sums().unwrap().diverged_at, Some(1));
    });
}
