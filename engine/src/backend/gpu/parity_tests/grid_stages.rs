//! Parity of every stage of a step on a dense grid.

use super::adapter::{on_adapter, open, open_narrow};
use super::compare::{Cpu, Gpu};
use super::grid_compare::compare_grids;
use crate::Error;
use crate::backend::GridDevice;
use crate::backend::cpu::Simd;
use crate::backend::gpu::GpuBackend;
use crate::train::dvgo::record::GridStages;
use crate::train::dvgo::tests::stages::{self, RAYS};
use crate::train::dvgo::{Stage, Steps};

/// Asserts that both sides agree, and that the device does not agree with the CPU's step of any `broken` stage.
fn agree<const C: usize>(
    name: &str,
    gpu: &GpuBackend,
    make: impl Fn() -> Stage<C>,
    broken: &[fn(&mut Stage<C>)],
) {
    let (stage, rays) = (make(), stages::rays(0));
    let mut grid = gpu.open_grid(&stage, &|| false).expect("fits");
    let device = Gpu(grid.stages(&stage, &rays).expect("works"));
    let host = |stage: &Stage<C>| Cpu(GridStages::on_cpu(stage, &rays, Simd::Baseline));
    let oracle = host(&stage);
    let found: usize = oracle.0.rays.iter().map(|ray| ray.samples.len()).sum();
    let shown = oracle.0.rays.iter().flat_map(|ray| &ray.samples);
    let shown = shown.filter(|sample| sample.shown.is_some()).count();
    assert!(
        found > 10 * RAYS && shown > RAYS && shown < found,
        "{found} {shown}"
    );
    let worst = compare_grids(&device, &oracle).unwrap_or_else(|what| panic!("{name}: {what}"));
    println!("{name}: {found} samples, {shown} coloured, {worst:?}");
    for (number, change) in broken.iter().enumerate() {
        let mut other = make();
        change(&mut other);
        let verdict = compare_grids(&device, &host(&other));
        assert!(verdict.is_err(), "{name}: broken stage {number} passes");
    }
}

#[test]
fn parity_dvgo_of_the_stages_of_a_coarse_step() {
    on_adapter("stages of a coarse step on a grid", |gpu| {
        let broken: [fn(&mut Stage<4>); 6] = [
            |stage| stage.activation.act_shift += 0.01,
            |stage| stage.losses.entropy *= 1.05,
            |stage| stage.losses.sample_color *= 1.05,
            |stage| stage.losses.backdrop = [1.0; 3],
            |stage| stage.grid.alpha_min = 1e-5,
            |stage| stage.colors.iter_mut().for_each(|node| node[1] += 0.02),
        ];
        agree("coarse step", gpu, stages::coarse, &broken);
    });
}

#[test]
fn parity_dvgo_of_the_stages_of_a_fine_step() {
    on_adapter("stages of a fine step on a grid", |gpu| {
        let broken: [fn(&mut Stage<12>); 5] = [
            |stage| stage.activation.act_shift += 0.01,
            |stage| stage.losses.ray_share *= 1.01,
            |stage| stage.grid.alpha_min *= 3.0,
            |stage| stage.colors.iter_mut().for_each(|node| node[11] += 0.05),
            |stage| {
                let mlp = stage.mlp.as_mut().expect("the fine stage has one");
                mlp.parameters_mut()[7] += 0.3;
            },
        ];
        agree("fine step", gpu, stages::fine, &broken);
    });
}

#[test]
fn parity_dvgo_of_a_grid_that_does_not_fit_which_says_what_it_needs() {
    on_adapter("a grid too large", |shared| {
        let binding = 64 << 10;
        let narrow = open_narrow(binding).expect("opens");
        let stage = stages::fine();
        let refused = Steps::open(&GridDevice::gpu(narrow), &stage, &|| false);
        let Err(Error::OutOfMemory {
            needed_bytes,
            available_bytes,
            ..
        }) = refused
        else {
            panic!("{refused:?}");
        };
        // Densities are the first to be too large.
        assert_eq!(needed_bytes, 4 * stage.shape.len() as u64);
        assert_eq!(available_bytes, binding);
        // Broken: the same grid where it fits.
        let mut grid = shared.open_grid(&stage, &|| false).expect("fits");
        grid.stages(&stage, &stages::rays(0)).expect("works");
    });
}

#[test]
fn parity_dvgo_of_cancelled_steps_which_dispatch_nothing_more() {
    on_adapter("cancelled steps on a grid", |shared| {
        // Of its own: others would dispatch on the shared one.
        let gpu = open().expect("opens");
        let (stage, rays) = (stages::fine(), stages::rays(0));
        let asked = std::cell::RefCell::new(Vec::new());
        let step = |stop: Option<usize>| {
            asked.borrow_mut().clear();
            let mut grid = gpu.open_grid(&stage, &|| false).expect("fits");
            grid.batches_of(16);
            grid.step(&stage, &rays, &|| {
                let mut asked = asked.borrow_mut();
                asked.push(gpu.dispatch_count());
                stop == Some(asked.len() - 1)
            })
        };
        step(None).expect("nobody cancels");
        let counts = asked.borrow().clone();
        // Ten batches of two submissions, the sums, one slice of the bricks, the network.
        assert_eq!(counts.len(), 2 * 10 + 3);
        let most = counts.windows(2).map(|pair| pair[1] - pair[0]).max();
        assert_eq!(most, Some(6), "kernels of a backward pass");
        for stop in [0, 1, 12, counts.len() - 1] {
            let stopped = step(Some(stop));
            assert!(matches!(stopped, Err(Error::Cancelled)), "{stopped:?}");
            let counts = asked.borrow().clone();
            assert_eq!(counts.len(), stop + 1, "asked again after a yes");
            assert_eq!(counts[stop], gpu.dispatch_count(), "dispatched after a yes");
        }
        let upload = gpu.open_grid(&stage, &|| true);
        assert!(upload.is_err(), "a cancelled upload is heeded");
        let mut grid = shared.open_grid(&stage, &|| false).expect("fits");
        grid.step(&stage, &rays, &|| false).expect("works");
    });
}
