//! Parity of optimiser steps.

use super::adapter::{on_adapter, open_narrow};
use super::stage_compare::relative_error;
use crate::backend::cpu::tests::{LOSSES, field, rays_of_all_sorts};
use crate::backend::cpu::{CpuTrainer, Simd, ViewCorrection};
use crate::backend::gpu::GpuBackend;
use crate::backend::trainer::quantile;
use crate::field::{BRICK_NODES, Field, Lattice};
use crate::scene::Draws;
use crate::train::ray::{Rates, RayLosses, TrainRay};

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
const RAYS: usize = 100;

/// Some steps on the same rays.
#[derive(Clone, Debug)]
struct Run {
    field: Field,
    rays: Vec<TrainRay>,
    losses: RayLosses,
    rates: Rates,
    /// Quantile of the range errors above which the next step leaves rays out; 0 leaves out none.
    trim_quantile: f64,
    /// Rays of a batch on the device.
    batch: usize,
}

impl Run {
    fn new(losses: RayLosses) -> Self {
        Self {
            field: field(),
            rays: rays_of_all_sorts(RAYS),
            losses,
            rates: RATES,
            trim_quantile: 0.0,
            batch: RAYS,
        }
    }

    /// Four views, every third ray mirrored.
    fn with_views(self) -> Self {
        let mut rays = self.rays;
        for (number, ray) in (0u32..).zip(&mut rays) {
            ray.view = number % 4;
            ray.mirrored = number % 3 == 1;
        }
        let rates = Rates {
            exposure: 0.02,
            pose_m: 2e-3,
            ..self.rates
        };
        let losses = RayLosses {
            exposure_prior: 0.1,
            pose_prior: 0.1,
            ..self.losses
        };
        Self {
            rays,
            rates,
            losses,
            ..self
        }
    }

    fn on_gpu(&self, gpu: &GpuBackend) -> Moved {
        let mut trainer = gpu.open_trainer(self.field.clone(), &|| false).unwrap();
        trainer.batches_of(self.batch);
        for _ in 0..STEPS {
            let (losses, quantile) = (&self.losses, self.trim_quantile);
            let stepped = trainer.step(&self.rays, losses, self.rates, quantile, &|| false);
            stepped.unwrap();
        }
        let views = trainer.view_corrections().unwrap();
        trainer.fetch(&|| false).unwrap();
        Moved::new(&self.field, trainer.field(), &views)
    }

    fn on_cpu(&self) -> Moved {
        let mut trainer = CpuTrainer::new(self.field.clone(), Simd::Baseline);
        let mut losses = self.losses;
        for _ in 0..STEPS {
            let sums = trainer.step(&self.rays, &losses, self.rates);
            if self.trim_quantile > 0.0 {
                losses.depth_trim_m = quantile(&sums.range_errors_m, self.trim_quantile);
            }
        }
        Moved::new(&self.field, trainer.field(), trainer.view_corrections())
    }
}

/// What each kind of parameters moved by: densities, features, network, sky, exposures, poses.
#[derive(Clone, Debug)]
struct Moved([Vec<f32>; 6]);

impl Moved {
    fn new(before: &Field, after: &Field, views: &[ViewCorrection]) -> Self {
        let (before, after) = (parameters(before), parameters(after));
        let exposures = views.iter().flat_map(|view| {
            let exposure = view.exposure;
            [exposure.log_gain, exposure.bias].concat()
        });
        let poses = views.iter().flat_map(|view| {
            let turn = view.pose.rotation.to_scaled_axis();
            [turn.to_array(), view.pose.translation_m.to_array()].concat()
        });
        let moved = |kind: usize| -> Vec<f32> {
            let pairs = after[kind].iter().zip(&before[kind]);
            pairs.map(|(after, before)| after - before).collect()
        };
        Self([
            moved(0),
            moved(1),
            moved(2),
            moved(3),
            exposures.collect(),
            poses.collect(),
        ])
    }

    /// Relative errors by kind; 0 for kinds that are not learned at all.
    fn errors(&self, cpu: &Self) -> [f64; 6] {
        std::array::from_fn(|kind| {
            let (gpu, cpu) = (&self.0[kind], &cpu.0[kind]);
            if gpu.is_empty() && cpu.is_empty() {
                return 0.0;
            }
            relative_error(gpu, cpu)
        })
    }
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

/// Asserts that both sides agree, and that the device does not agree with any of the `broken` runs of the CPU.
fn agree(name: &str, run: &Run, broken: &[Run]) {
    on_adapter(name, |gpu| compare(name, &run.on_gpu(gpu), run, broken));
}

fn compare(name: &str, device: &Moved, run: &Run, broken: &[Run]) {
    let errors = device.errors(&run.on_cpu());
    println!(
        "{name}: relative errors of density, features, network, sky, exposures, poses: {errors:?}"
    );
    assert!(errors.iter().all(|e| *e < MOVED), "{name}: {errors:?}");
    for (number, run) in broken.iter().enumerate() {
        let verdict = device.errors(&run.on_cpu());
        assert!(
            verdict.iter().any(|e| *e > MOVED),
            "{name}: broken run {number} passes: {verdict:?}"
        );
    }
}

#[test]
fn parity_of_five_steps() {
    let run = Run::new(LOSSES);
    let off: [fn(&mut Rates); 4] = [
        |rates| rates.density *= 1.1,
        |rates| rates.features *= 1.1,
        |rates| rates.mlp *= 1.1,
        |rates| rates.sky *= 1.1,
    ];
    let broken = off.map(|change| {
        let mut other = run.clone();
        change(&mut other.rates);
        other
    });
    agree("five steps", &run, &broken);
}

#[test]
fn parity_of_steps_of_several_batches() {
    let run = Run {
        batch: 7,
        ..Run::new(LOSSES)
    };
    let mut without_last_batch = run.clone();
    without_last_batch.rays.truncate(RAYS / 7 * 7);
    let mut without_first_batch = run.clone();
    without_first_batch.rays.drain(..7);
    agree(
        "several batches",
        &run,
        &[without_last_batch, without_first_batch],
    );
}

#[test]
fn parity_of_steps_with_total_variation() {
    let losses = RayLosses {
        density_variation: 0.3,
        feature_variation: 0.3,
        ..LOSSES
    };
    let without = |change: fn(&mut RayLosses)| {
        let mut other = Run::new(losses);
        change(&mut other.losses);
        other
    };
    let broken = [
        without(|losses| losses.density_variation = 0.0),
        without(|losses| losses.feature_variation = 0.0),
    ];
    agree("total variation", &Run::new(losses), &broken);
}

#[test]
fn parity_of_steps_that_trim_the_worst_ranges() {
    let run = Run {
        trim_quantile: 0.5,
        ..Run::new(LOSSES)
    };
    let other = |trim_quantile| Run {
        trim_quantile,
        ..run.clone()
    };
    agree("trimmed ranges", &run, &[other(0.0), other(0.8)]);
}

#[test]
fn parity_of_steps_with_distortion() {
    let losses = RayLosses {
        distortion: 0.5,
        ..LOSSES
    };
    agree("distortion", &Run::new(losses), &[Run::new(LOSSES)]);
}

#[test]
fn parity_of_steps_that_learn_exposures_and_poses() {
    let run = Run::new(LOSSES).with_views();
    let other = |change: fn(&mut Run)| {
        let mut other = run.clone();
        change(&mut other);
        other
    };
    let broken = [
        other(|run| run.rates.exposure *= 1.1),
        other(|run| run.rates.pose_m *= 1.1),
        other(|run| run.losses.exposure_prior = 0.0),
        other(|run| run.rays.iter_mut().for_each(|ray| ray.mirrored = false)),
        other(|run| {
            let rays = run.rays.iter_mut();
            rays.for_each(|ray| ray.view = (ray.view + 1) % 4);
        }),
    ];
    agree("exposures and poses", &run, &broken);
    let run = Run { batch: 9, ..run };
    agree("exposures and poses in batches", &run, &[]);
}

/// Bindings of 128 KiB divide the densities of 78 thousand nodes in three and their features in ten.
#[test]
fn parity_of_steps_of_fields_that_no_binding_holds() {
    on_adapter("split training", |whole| {
        let run = Run {
            field: finer(),
            ..Run::new(RayLosses {
                density_variation: 0.3,
                feature_variation: 0.3,
                ..LOSSES
            })
            .with_views()
        };
        let narrow = open_narrow(128 << 10).expect("opens");
        let trainer = narrow
            .open_trainer(run.field.clone(), &|| false)
            .expect("fits");
        let [densities, features] = trainer.part_counts();
        drop(trainer);
        assert!(
            (2..=4).contains(&densities) && features > 4,
            "{densities} and {features} parts"
        );
        let before = narrow.dispatch_count();
        let split = run.on_gpu(&narrow);
        assert!(narrow.dispatch_count() > before, "nothing was dispatched");
        let mut forgets = run.clone();
        forgets.losses.density_variation = 0.0;
        compare("split training", &split, &run, &[forgets]);
        let unsplit = run.on_gpu(whole);
        let errors = split.errors(&unsplit);
        println!("split against whole: {errors:?}");
        assert!(errors.iter().all(|e| *e < MOVED), "{errors:?}");
        // Broken: the last part of the nodes does not learn.
        let mut frozen = split.clone();
        let nodes = frozen.0[1].len();
        frozen.0[1][nodes - nodes / 10..].fill(0.0);
        assert!(frozen.errors(&unsplit).iter().any(|e| *e > MOVED));
    });
}

/// The test field with a third level, dense, of half the voxel.
fn finer() -> Field {
    let mut field = field();
    let mut draws = Draws::new(31, 0, 0);
    let (low, high) = field.bounds();
    let mut level = Lattice::new(0.0625, low, high - low).expect("a small box");
    level.allocate_all();
    let (density, features) = level.parameters_mut();
    for value in &mut density[BRICK_NODES..] {
        *value = draws.uniform(-0.5, 0.5) as f32;
    }
    for node in &mut features[BRICK_NODES..] {
        *node = std::array::from_fn(|_| draws.jitter(0.5) as f32);
    }
    field.levels.push(level);
    field
}
