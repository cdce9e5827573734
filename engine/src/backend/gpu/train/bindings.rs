//! Which buffers each kernel of a step sees.

use backlot_shaders::layout;

use super::batch::Batch;
use super::kernels::TrainKernels;
use super::lattices::Lattices;
use super::part_bindings::NodeBindings;
use super::sky::Sky;
use super::state::StepBuffers;
use super::views::OnDevice;
use crate::backend::gpu::buffer::Buffer;
use crate::backend::gpu::device::Device;
use crate::backend::gpu::error::Error;
use crate::backend::gpu::march::march_buffers;
use crate::backend::gpu::network::{NetworkBindings, NetworkBuffers, ResidentNetwork};

/// All buffers of a trainer.
#[derive(Clone, Copy, Debug)]
pub(super) struct Buffers<'a> {
    pub(super) march_params: &'a Buffer<layout::MarchParams>,
    pub(super) lattices: &'a Lattices,
    pub(super) network: &'a ResidentNetwork,
    pub(super) sky: &'a Sky,
    pub(super) views: &'a OnDevice,
    pub(super) batch: &'a Batch,
    pub(super) step: &'a StepBuffers,
}

/// One bind group a kernel.
#[derive(Debug)]
pub(super) struct Bindings {
    pub(super) correct: wgpu::BindGroup,
    pub(super) march: wgpu::BindGroup,
    pub(super) composite: wgpu::BindGroup,
    pub(super) network: NetworkBindings,
    pub(super) losses: wgpu::BindGroup,
    pub(super) sum: wgpu::BindGroup,
    pub(super) step_sky: wgpu::BindGroup,
    pub(super) step_views: wgpu::BindGroup,
    /// One a part of the nodes.
    pub(super) parts: Vec<NodeBindings>,
}

impl Bindings {
    pub(super) fn new(
        device: &Device,
        kernels: &TrainKernels,
        buffers: Buffers<'_>,
    ) -> Result<Self, Error> {
        let parts = 0..buffers.lattices.parts.len();
        Ok(Self {
            correct: correct(device, kernels, buffers)?,
            march: march(device, kernels, buffers)?,
            composite: composite(device, kernels, buffers)?,
            network: NetworkBindings::new(device, &kernels.network, network(buffers))?,
            losses: losses(device, kernels, buffers)?,
            sum: sum(device, kernels, buffers)?,
            step_sky: step_sky(device, kernels, buffers)?,
            step_views: step_views(device, kernels, buffers)?,
            parts: parts
                .map(|part| NodeBindings::new(device, kernels, buffers, part))
                .collect::<Result<_, _>>()?,
        })
    }
}

pub(super) type Bound = Result<wgpu::BindGroup, Error>;

fn correct(device: &Device, kernels: &TrainKernels, buffers: Buffers<'_>) -> Bound {
    let own = [
        &buffers.step.params.raw,
        &buffers.batch.targets.raw,
        &buffers.views.views.raw,
        &buffers.batch.rays.raw,
        &buffers.views.sums.raw,
    ];
    kernels.correct.bind(device, &own)
}

fn march(device: &Device, kernels: &TrainKernels, buffers: Buffers<'_>) -> Bound {
    let batch = buffers.batch;
    let own = [
        &buffers.march_params.raw,
        &batch.rays.raw,
        &batch.summaries.raw,
        &batch.samples.raw,
    ];
    let all = march_buffers(&buffers.lattices.shape, own);
    kernels.march.bind(device, &all)
}

fn composite(device: &Device, kernels: &TrainKernels, buffers: Buffers<'_>) -> Bound {
    let batch = buffers.batch;
    let own = [
        &buffers.step.params.raw,
        &batch.summaries.raw,
        &batch.samples.raw,
        &batch.targets.raw,
        &batch.weights.raw,
        &batch.slots.raw,
        &batch.slot_samples.raw,
        &batch.first_points.raw,
        &batch.counters.raw,
    ];
    kernels.composite.bind(device, &own)
}

/// What the colour network's kernels see.
pub(super) fn network(buffers: Buffers<'_>) -> NetworkBuffers<'_> {
    let batch = buffers.batch;
    NetworkBuffers {
        network: buffers.network,
        moments: &buffers.step.moments,
        batch: &batch.network,
        counters: &batch.counters,
        slot_colors: &batch.slot_colors,
        slot_color_gradients: &batch.slot_color_gradients,
        params: &buffers.step.params,
        state: &buffers.step.state,
    }
}

fn losses(device: &Device, kernels: &TrainKernels, buffers: Buffers<'_>) -> Bound {
    let (sky, batch) = (buffers.sky, buffers.batch);
    let own = [
        &buffers.step.params.raw,
        &batch.rays.raw,
        &batch.targets.raw,
        &batch.summaries.raw,
        &batch.samples.raw,
        &batch.weights.raw,
        &batch.slots.raw,
        &batch.first_points.raw,
        &batch.slot_colors.raw,
        &sky.grids.raw,
        &sky.logits.raw,
        &buffers.views.views.raw,
        &batch.slot_color_gradients.raw,
        &batch.points.raw,
        &sky.gradients.raw,
        &batch.ray_losses.raw,
        &buffers.views.sums.raw,
        &buffers.step.state.raw,
    ];
    kernels.losses.bind(device, &own)
}

fn sum(device: &Device, kernels: &TrainKernels, buffers: Buffers<'_>) -> Bound {
    let own = [
        &buffers.step.params.raw,
        &buffers.batch.ray_losses.raw,
        &buffers.batch.counters.raw,
        &buffers.step.state.raw,
    ];
    kernels.sum.bind(device, &own)
}

fn step_sky(device: &Device, kernels: &TrainKernels, buffers: Buffers<'_>) -> Bound {
    let sky = buffers.sky;
    let own = [
        &buffers.step.params.raw,
        &buffers.step.state.raw,
        &sky.gradients.raw,
        &sky.squares.raw,
        &sky.logits.raw,
    ];
    kernels.step_sky.bind(device, &own)
}

fn step_views(device: &Device, kernels: &TrainKernels, buffers: Buffers<'_>) -> Bound {
    let views = buffers.views;
    let own = [
        &buffers.step.params.raw,
        &buffers.step.state.raw,
        &views.views.raw,
        &views.sums.raw,
        &views.moments.raw,
    ];
    kernels.step_views.bind(device, &own)
}
