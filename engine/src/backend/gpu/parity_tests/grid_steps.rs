//! Parity of optimiser steps on dense grids.

use super::adapter::on_adapter;
use super::stage_compare::relative_error;
use crate::Error;
use crate::backend::GridDevice;
use crate::backend::cpu::Simd;
use crate::backend::gpu::GpuBackend;
use crate::train::dvgo::tests::stages;
use crate::train::dvgo::{Stage, Steps};

/// Relative error of what a kind of values moved by. Adam divides by the gradient's own size, so that a node whose gradient is rounding only
/// moves as far as others, either way.
const MOVED: f64 = 1e-2;
const STEPS: u64 = 5;

/// What each kind of values moved by: densities, colour values, network.
#[derive(Clone, Debug)]
struct Moved([Vec<f32>; 3]);

impl Moved {
    fn errors(&self, cpu: &Self) -> [f64; 3] {
        std::array::from_fn(|kind| {
            let (gpu, cpu) = (&self.0[kind], &cpu.0[kind]);
            if gpu.is_empty() && cpu.is_empty() {
                return 0.0;
            }
            relative_error(gpu, cpu)
        })
    }
}

fn values<const C: usize>(stage: &Stage<C>) -> [Vec<f32>; 3] {
    let weights = stage.mlp.as_ref().map(|mlp| mlp.parameters().to_vec());
    [
        stage.density.clone(),
        stage.colors.as_flattened().to_vec(),
        weights.unwrap_or_default(),
    ]
}

/// Some steps, after the third of which the mask is renewed.
fn run<const C: usize>(device: &GridDevice, mut stage: Stage<C>, skipped: Option<u64>) -> Moved {
    let before = values(&stage);
    let go_on = || false;
    let mut steps = Steps::open(device, &stage, &go_on).expect("fits");
    for step in (0..STEPS).filter(|step| Some(*step) != skipped) {
        if step == 3 {
            steps.renew_mask(&mut stage, &go_on).expect("works");
        }
        let taken = steps.step(&mut stage, &stages::rays(step), step, &go_on);
        taken.expect("is finite");
    }
    steps.fetch(&mut stage, &go_on).expect("works");
    let after = values(&stage);
    Moved(std::array::from_fn(|kind| {
        let pairs = after[kind].iter().zip(&before[kind]);
        pairs.map(|(after, before)| after - before).collect()
    }))
}

/// Asserts that both sides agree, and that the device agrees neither with the CPU's steps of a `broken` stage nor with one step less.
fn agree<const C: usize>(
    name: &str,
    gpu: &GpuBackend,
    make: impl Fn() -> Stage<C>,
    broken: &[fn(&mut Stage<C>)],
) {
    let host = GridDevice::cpu_in_f32(Simd::Baseline);
    let device = run(&GridDevice::gpu(gpu.clone()), make(), None);
    let errors = device.errors(&run(&host, make(), None));
    println!("{name}: relative errors of densities, colour values, network: {errors:?}");
    assert!(errors.iter().all(|e| *e < MOVED), "{name}: {errors:?}");
    for (number, change) in broken.iter().enumerate() {
        let mut other = make();
        change(&mut other);
        let verdict = device.errors(&run(&host, other, None));
        assert!(
            verdict.iter().any(|e| *e > MOVED),
            "{name}: broken run {number} passes: {verdict:?}"
        );
    }
    let verdict = device.errors(&run(&host, make(), Some(2)));
    assert!(verdict.iter().any(|e| *e > MOVED), "{name}: {verdict:?}");
}

#[test]
fn parity_dvgo_of_five_coarse_steps() {
    on_adapter("five coarse steps on a grid", |gpu| {
        let broken: [fn(&mut Stage<4>); 5] = [
            |stage| stage.recipe.density_rate *= 1.1,
            |stage| stage.recipe.color_rate *= 1.1,
            |stage| stage.recipe.decay_steps = 20.0,
            |stage| stage.recipe.masked = true,
            |stage| stage.density_shares.clear(),
        ];
        agree("five coarse steps", gpu, stages::coarse, &broken);
    });
}

#[test]
fn parity_dvgo_of_five_fine_steps() {
    on_adapter("five fine steps on a grid", |gpu| {
        let broken: [fn(&mut Stage<12>); 5] = [
            |stage| stage.recipe.density_rate *= 1.1,
            |stage| stage.recipe.color_rate *= 1.1,
            |stage| stage.recipe.mlp_rate *= 1.1,
            |stage| stage.recipe.masked = false,
            |stage| stage.grid.alpha_min = 0.1,
        ];
        agree("five fine steps", gpu, stages::fine, &broken);
    });
}

/// Bricks of which half have no gradient for longer than they move without one, and then have one again.
#[test]
fn parity_dvgo_of_bricks_that_rest_and_wake() {
    on_adapter("resting bricks of a grid", |gpu| {
        let host = GridDevice::cpu_in_f32(Simd::Baseline);
        let device = GridDevice::gpu(gpu.clone());
        let rested = |device: &GridDevice, steps_of_rest: u64| {
            let mut stage = stages::coarse();
            let before = values(&stage);
            let all = stages::rays(0);
            let few = [all[0]];
            let mut steps = Steps::open(device, &stage, &|| false).expect("fits");
            for number in 0..steps_of_rest + 2 {
                let is_end = number == 0 || number == steps_of_rest + 1;
                let rays = if is_end { &all[..] } else { &few };
                let taken = steps.step(&mut stage, rays, number, &|| false);
                taken.expect("is finite");
            }
            steps.fetch(&mut stage, &|| false).expect("works");
            let after = values(&stage);
            Moved(std::array::from_fn(|kind| {
                let pairs = after[kind].iter().zip(&before[kind]);
                pairs.map(|(after, before)| after - before).collect()
            }))
        };
        let (moved, oracle) = (rested(&device, 230), rested(&host, 230));
        let errors = moved.errors(&oracle);
        println!("resting bricks: relative errors {errors:?}");
        assert!(errors.iter().all(|e| *e < MOVED), "{errors:?}");
        let other = moved.errors(&rested(&host, 210));
        assert!(other.iter().any(|e| *e > MOVED), "another rest passes");
    });
}

#[test]
fn parity_dvgo_of_the_step_that_diverged() {
    on_adapter("divergence on a grid", |gpu| {
        let host = GridDevice::cpu_in_f32(Simd::Baseline);
        let device = GridDevice::gpu(gpu.clone());
        let diverged = |device: &GridDevice, poisoned: u64| {
            let mut stage = stages::fine();
            let mut steps = Steps::open(device, &stage, &|| false).expect("fits");
            // The run's numbers go on from the stage's before.
            for number in 100..120 {
                let mut rays = stages::rays(number);
                if number == poisoned {
                    rays[5].color[1] = f32::NAN;
                }
                match steps.step(&mut stage, &rays, number, &|| false) {
                    Ok(_) => {}
                    Err(Error::Diverged { step, quantity }) => return (step, quantity),
                    Err(other) => panic!("{other}"),
                }
            }
            match steps.fetch(&mut stage, &|| false) {
                Err(Error::Diverged { step, quantity }) => (step, quantity),
                other => panic!("{other:?}"),
            }
        };
        // One that is asked about at once, one that others have followed by then, and one that only the fetch tells.
        for step in [103, 109, 118] {
            assert_eq!(diverged(&device, step), (step, "loss"));
            assert_eq!(diverged(&host, step), (step, "loss"));
            assert_ne!(diverged(&host, step + 1), (step, "loss"));
        }
    });
}
