//! The end of a step: its sums, and all parameters moved against their gradients.

use backlot_shaders::layout;

use super::GpuTrainer;
use super::part_bindings::NodeBindings;
use crate::backend::gpu::error::Error;
use crate::backend::gpu::free_groups;
use crate::backend::gpu::pipeline::{Groups, Pipeline};
use crate::backend::gpu::sequence::Sequence;
use crate::backend::gpu::submissions::{bricks_per_submission, go_on};
use crate::field::BRICK_NODES;

impl GpuTrainer {
    /// Sums the step's losses and moves all parameters. `cancelled` is asked between pieces of at most some tens of milliseconds.
    pub(super) fn update(
        &mut self,
        params: layout::TrainParams,
        cancelled: &dyn Fn() -> bool,
    ) -> crate::Result<()> {
        go_on(cancelled)?;
        self.sum_step(params)?;
        let varies = params.density_variation_rate > 0.0 || params.feature_variation_rate > 0.0;
        let (lattices, _, bindings) = self.resident();
        let bricks = (lattices.nodes() / BRICK_NODES) as u32;
        let parts = bindings.parts.len();
        // Gradients of the variation are of what the losses' have moved, all of it.
        for stage in [Stage::Step, Stage::Vary, Stage::Smooth] {
            if stage != Stage::Step && !varies {
                continue;
            }
            for part in 0..parts {
                for first in (0..bricks).step_by(bricks_per_submission(&self.device)) {
                    go_on(cancelled)?;
                    let params = layout::TrainParams {
                        first_touched: first,
                        touched_end: first + bricks_per_submission(&self.device) as u32,
                        ..params
                    };
                    self.move_bricks(stage, part, params)?;
                }
            }
        }
        go_on(cancelled)?;
        Ok(self.move_rest(params)?)
    }

    fn sum_step(&mut self, params: layout::TrainParams) -> Result<(), Error> {
        self.submit(|trainer| {
            trainer.step.params.write(&trainer.device, &[params]);
            let (_, _, bindings) = trainer.resident();
            let mut sequence = Sequence::new(&trainer.device, "sums of a step");
            let one = Groups { x: 1, y: 1 };
            sequence.run(&trainer.kernels.sum, &bindings.sum, one);
            sequence
        })
    }

    /// One stage of one part's share of some touched bricks.
    fn move_bricks(
        &mut self,
        stage: Stage,
        part: usize,
        params: layout::TrainParams,
    ) -> Result<(), Error> {
        self.submit(|trainer| {
            trainer.step.params.write(&trainer.device, &[params]);
            let (_, _, bindings) = trainer.resident();
            let free = free_groups(&trainer.device);
            let mut sequence = Sequence::new(&trainer.device, "step of some bricks");
            let (kernel, bound) = trainer.stage(stage, &bindings.parts[part]);
            for bound in bound {
                sequence.run(kernel, bound, free);
            }
            sequence
        })
    }

    fn stage<'a>(
        &'a self,
        stage: Stage,
        part: &'a NodeBindings,
    ) -> (&'a Pipeline, &'a [wgpu::BindGroup]) {
        match stage {
            Stage::Step => (
                &self.kernels.step_bricks,
                std::slice::from_ref(&part.step_bricks),
            ),
            Stage::Vary => (&self.kernels.variation, &part.variation),
            Stage::Smooth => (&self.kernels.smooth, std::slice::from_ref(&part.smooth)),
        }
    }

    /// The network, the sky and the views; the list of touched bricks is empty then.
    fn move_rest(&mut self, params: layout::TrainParams) -> Result<(), Error> {
        self.submit(|trainer| {
            let (device, kernels) = (&trainer.device, &trainer.kernels);
            let (lattices, _, bindings) = trainer.resident();
            let mut sequence = Sequence::new(device, "step of network, sky and views");
            sequence.clear(&lattices.touched_bricks.raw, 4);
            kernels
                .network
                .run_step(device, &mut sequence, &bindings.network);
            trainer.network.spread(&mut sequence);
            if params.sky_texel_count > 0 {
                sequence.run(&kernels.step_sky, &bindings.step_sky, free_groups(device));
            }
            if params.view_count > 0 {
                let one = Groups { x: 1, y: 1 };
                sequence.run(&kernels.step_views, &bindings.step_views, one);
            }
            sequence
        })
    }
}

/// What is done to touched bricks, in this order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stage {
    Step,
    Vary,
    Smooth,
}
