//! What a step hands to the device, piece by piece.

use backlot_shaders::{grid_layout, layout};

use super::GpuGrid;
use super::params::pixel_ray;
use crate::backend::gpu::error::Error;
use crate::backend::gpu::free_groups;
use crate::backend::gpu::pipeline::Groups;
use crate::backend::gpu::sequence::Sequence;
use crate::backend::gpu::submissions::{bricks_per_submission, go_on};
use crate::train::dvgo::PixelRay;

impl GpuGrid {
    /// From rays to the colours of their samples.
    pub(super) fn submit_forward(
        &mut self,
        rays: &[PixelRay],
        params: grid_layout::GridParams,
        train: layout::TrainParams,
    ) -> Result<(), Error> {
        self.rays.clear();
        self.rays.extend(rays.iter().map(pixel_ray));
        self.submit(|grid| {
            let (device, kernels, bindings) = (&grid.device, &grid.kernels, &grid.bindings);
            grid.batch.rays.write(device, &grid.rays);
            grid.step.params.write(device, &[params]);
            grid.step.train.write(device, &[train]);
            let free = free_groups(device);
            let per_ray = kernels.march.groups(device, params.ray_count);
            let mut sequence = Sequence::new(device, "grid batch, forward");
            // The step's counts follow the batch's.
            let counters = if params.first_ray == 0 { 16 } else { 8 };
            sequence.clear(&grid.batch.counters.raw, counters);
            sequence.run(&kernels.march, &bindings.march, per_ray);
            sequence.run(&kernels.gather, &bindings.gather, free);
            if let (Some(kernels), Some(bindings)) = (&kernels.network, &bindings.network) {
                sequence.run(&kernels.forward, &bindings.forward, free);
            }
            sequence
        })
    }

    /// From losses to gradients by all values.
    pub(super) fn submit_backward(&mut self, params: grid_layout::GridParams) -> Result<(), Error> {
        self.submit(|grid| {
            let (device, kernels, bindings) = (&grid.device, &grid.kernels, &grid.bindings);
            let per_ray = kernels.losses.groups(device, params.ray_count);
            let mut sequence = Sequence::new(device, "grid batch, backward");
            sequence.run(&kernels.losses, &bindings.losses, per_ray);
            if let (Some(kernels), Some(bindings)) = (&kernels.network, &bindings.network) {
                let shares = grid.batch.capacity.shares;
                kernels.run_backward(device, &mut sequence, bindings, shares);
            }
            sequence.run(&kernels.scatter, &bindings.scatter, free_groups(device));
            sequence
        })
    }

    /// Sums the step's losses and moves all values.
    pub(super) fn update(
        &mut self,
        params: grid_layout::GridParams,
        cancelled: &dyn Fn() -> bool,
    ) -> crate::Result<()> {
        go_on(cancelled)?;
        let bricks = params.bricks.iter().product();
        self.sum_step(grid_layout::GridParams {
            brick_end: bricks,
            ..params
        })?;
        let at_once = bricks_per_submission(&self.device) as u32;
        for first_brick in (0..bricks).step_by(at_once as usize) {
            go_on(cancelled)?;
            self.move_bricks(grid_layout::GridParams {
                first_brick,
                brick_end: bricks.min(first_brick + at_once),
                ..params
            })?;
        }
        if self.network.is_some() {
            go_on(cancelled)?;
            self.move_network()?;
        }
        Ok(())
    }

    /// Sums the losses and decides which bricks move.
    fn sum_step(&mut self, params: grid_layout::GridParams) -> Result<(), Error> {
        self.submit(|grid| {
            let (device, kernels, bindings) = (&grid.device, &grid.kernels, &grid.bindings);
            grid.step.params.write(device, &[params]);
            let mut sequence = Sequence::new(device, "sums of a grid's step");
            sequence.run(&kernels.sum, &bindings.sum, Groups { x: 1, y: 1 });
            let per_brick = kernels.wake.groups(device, params.brick_end);
            sequence.run(&kernels.wake, &bindings.wake, per_brick);
            sequence
        })
    }

    fn move_bricks(&mut self, params: grid_layout::GridParams) -> Result<(), Error> {
        self.submit(|grid| {
            let (device, kernels, bindings) = (&grid.device, &grid.kernels, &grid.bindings);
            grid.step.params.write(device, &[params]);
            let free = free_groups(device);
            let mut sequence = Sequence::new(device, "step of a grid's bricks");
            sequence.run(&kernels.step_density, &bindings.step_density, free);
            for bound in &bindings.step_quads {
                sequence.run(&kernels.step_quad, bound, free);
            }
            sequence
        })
    }

    fn move_network(&mut self) -> Result<(), Error> {
        self.submit(|grid| {
            let mut sequence = Sequence::new(&grid.device, "step of a grid's network");
            if let (Some(kernels), Some(bindings), Some(network)) =
                (&grid.kernels.network, &grid.bindings.network, &grid.network)
            {
                kernels.run_step(&grid.device, &mut sequence, bindings);
                network.resident.spread(&mut sequence);
            }
            sequence
        })
    }
}
