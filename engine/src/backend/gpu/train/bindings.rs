//! Which buffers each kernel of a step sees.

use backlot_shaders::layout;

use super::batch::Batch;
use super::kernels::TrainKernels;
use super::lattices::Lattices;
use super::network::{ResidentNetwork, layer_params};
use super::part_bindings::NodeBindings;
use super::sky::Sky;
use super::state::StepBuffers;
use super::views::OnDevice;
use crate::backend::gpu::buffer::Buffer;
use crate::backend::gpu::device::Device;
use crate::backend::gpu::error::Error;
use crate::backend::gpu::march::march_buffers;
use crate::backend::gpu::pipeline::Pipeline;

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
    pub(super) forward: wgpu::BindGroup,
    pub(super) losses: wgpu::BindGroup,
    pub(super) backward: wgpu::BindGroup,
    /// One a layer.
    pub(super) layer_gradients: [wgpu::BindGroup; 3],
    pub(super) sum: wgpu::BindGroup,
    pub(super) step_network: wgpu::BindGroup,
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
            forward: forward(device, &kernels.forward, buffers)?,
            losses: losses(device, kernels, buffers)?,
            backward: backward(device, kernels, buffers)?,
            layer_gradients: layer_gradients(device, kernels, buffers)?,
            sum: sum(device, kernels, buffers)?,
            step_network: step_network(device, kernels, buffers)?,
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

/// Of either variant.
pub(super) fn forward(device: &Device, kernel: &Pipeline, buffers: Buffers<'_>) -> Bound {
    let batch = buffers.batch;
    let [first, second, third] = &buffers.network.layers;
    let own = [
        &first.raw,
        &second.raw,
        &third.raw,
        &batch.counters.raw,
        &batch.slot_inputs.raw,
        &batch.hidden[0].raw,
        &batch.hidden[1].raw,
        &batch.slot_colors.raw,
    ];
    kernel.bind(device, &own)
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

fn backward(device: &Device, kernels: &TrainKernels, buffers: Buffers<'_>) -> Bound {
    let batch = buffers.batch;
    let [first, second, third] = &buffers.network.layers;
    let own = [
        &first.raw,
        &second.raw,
        &third.raw,
        &batch.counters.raw,
        &batch.hidden[0].raw,
        &batch.hidden[1].raw,
        &batch.slot_colors.raw,
        &batch.slot_color_gradients.raw,
        &batch.hidden_gradients[0].raw,
        &batch.hidden_gradients[1].raw,
        &batch.slot_gradients.raw,
    ];
    kernels.backward.bind(device, &own)
}

fn layer_gradients(
    device: &Device,
    kernels: &TrainKernels,
    buffers: Buffers<'_>,
) -> Result<[wgpu::BindGroup; 3], Error> {
    let batch = buffers.batch;
    let [by_a, by_b] = &batch.hidden_gradients;
    let layers = layer_params(buffers.network.layout());
    let layer = |number: usize, inputs: &wgpu::Buffer, gradients: &wgpu::Buffer| {
        let own = [
            &batch.layers[number].raw,
            &batch.counters.raw,
            inputs,
            gradients,
            &batch.weight_gradients.raw,
        ];
        let layer = &layers[number];
        kernels.layer_gradients(layer).bind(device, &own)
    };
    Ok([
        layer(0, &batch.slot_inputs.raw, &by_a.raw)?,
        layer(1, &batch.hidden[0].raw, &by_b.raw)?,
        layer(2, &batch.hidden[1].raw, &batch.slot_color_gradients.raw)?,
    ])
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

fn step_network(device: &Device, kernels: &TrainKernels, buffers: Buffers<'_>) -> Bound {
    let own = [
        &buffers.step.params.raw,
        &buffers.step.state.raw,
        &buffers.batch.weight_gradients.raw,
        &buffers.step.moments.raw,
        &buffers.network.weights.raw,
    ];
    kernels.step_network.bind(device, &own)
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
