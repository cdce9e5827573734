//! Which buffers each kernel of a step sees.

use backlot_shaders::layout;

use super::batch::Batch;
use super::kernels::TrainKernels;
use super::lattices::Lattices;
use super::network::ResidentNetwork;
use super::sky::Sky;
use super::state::StepBuffers;
use crate::backend::gpu::buffer::Buffer;
use crate::backend::gpu::device::Device;
use crate::backend::gpu::error::Error;

/// All buffers of a trainer.
#[derive(Clone, Copy, Debug)]
pub(super) struct Buffers<'a> {
    pub(super) march_params: &'a Buffer<layout::MarchParams>,
    pub(super) lattices: &'a Lattices,
    pub(super) network: &'a ResidentNetwork,
    pub(super) sky: &'a Sky,
    pub(super) batch: &'a Batch,
    pub(super) step: &'a StepBuffers,
}

/// One bind group a kernel.
#[derive(Debug)]
pub(super) struct Bindings {
    pub(super) march: wgpu::BindGroup,
    pub(super) composite: wgpu::BindGroup,
    pub(super) gather: wgpu::BindGroup,
    pub(super) forward: wgpu::BindGroup,
    pub(super) losses: wgpu::BindGroup,
    pub(super) backward: wgpu::BindGroup,
    /// One a layer.
    pub(super) layer_gradients: [wgpu::BindGroup; 3],
    pub(super) scatter: wgpu::BindGroup,
    pub(super) sum: wgpu::BindGroup,
    pub(super) step_bricks: wgpu::BindGroup,
    pub(super) step_network: wgpu::BindGroup,
    pub(super) step_sky: wgpu::BindGroup,
    pub(super) variation: wgpu::BindGroup,
    pub(super) smooth: wgpu::BindGroup,
}

impl Bindings {
    pub(super) fn new(
        device: &Device,
        kernels: &TrainKernels,
        buffers: Buffers<'_>,
    ) -> Result<Self, Error> {
        Ok(Self {
            march: march(device, kernels, buffers)?,
            composite: composite(device, kernels, buffers)?,
            gather: gather(device, kernels, buffers)?,
            forward: forward(device, kernels, buffers)?,
            losses: losses(device, kernels, buffers)?,
            backward: backward(device, kernels, buffers)?,
            layer_gradients: layer_gradients(device, kernels, buffers)?,
            scatter: scatter(device, kernels, buffers)?,
            sum: sum(device, kernels, buffers)?,
            step_bricks: step_bricks(device, kernels, buffers)?,
            step_network: step_network(device, kernels, buffers)?,
            step_sky: step_sky(device, kernels, buffers)?,
            variation: variation(device, kernels, buffers)?,
            smooth: smooth(device, kernels, buffers)?,
        })
    }
}

type Bound = Result<wgpu::BindGroup, Error>;

fn march(device: &Device, kernels: &TrainKernels, buffers: Buffers<'_>) -> Bound {
    let (lattices, batch) = (buffers.lattices, buffers.batch);
    let own = [
        &buffers.march_params.raw,
        &lattices.levels.raw,
        &lattices.brick_index.raw,
        &lattices.density.raw,
        &lattices.block_index.raw,
        &lattices.blocks.raw,
        &batch.rays.raw,
        &batch.summaries.raw,
        &batch.samples.raw,
    ];
    kernels.march.bind(device, &own)
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

fn gather(device: &Device, kernels: &TrainKernels, buffers: Buffers<'_>) -> Bound {
    let (lattices, batch) = (buffers.lattices, buffers.batch);
    let [a, b, c] = &lattices.features;
    let own = [
        &buffers.step.params.raw,
        &lattices.levels.raw,
        &lattices.brick_index.raw,
        &a.raw,
        &b.raw,
        &c.raw,
        &batch.rays.raw,
        &batch.slot_samples.raw,
        &batch.counters.raw,
        &batch.slot_inputs.raw,
    ];
    kernels.gather.bind(device, &own)
}

fn forward(device: &Device, kernels: &TrainKernels, buffers: Buffers<'_>) -> Bound {
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
    kernels.forward.bind(device, &own)
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
        &buffers.step.exposures.raw,
        &batch.slot_color_gradients.raw,
        &batch.points.raw,
        &sky.gradients.raw,
        &batch.ray_losses.raw,
        &batch.exposure_gradients.raw,
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
    let layer = |number: usize, inputs: &wgpu::Buffer, gradients: &wgpu::Buffer| {
        let own = [
            &batch.layers[number].raw,
            &batch.counters.raw,
            inputs,
            gradients,
            &batch.weight_gradients.raw,
        ];
        kernels.layer_gradients.bind(device, &own)
    };
    Ok([
        layer(0, &batch.slot_inputs.raw, &by_a.raw)?,
        layer(1, &batch.hidden[0].raw, &by_b.raw)?,
        layer(2, &batch.hidden[1].raw, &batch.slot_color_gradients.raw)?,
    ])
}

fn scatter(device: &Device, kernels: &TrainKernels, buffers: Buffers<'_>) -> Bound {
    let (lattices, batch) = (buffers.lattices, buffers.batch);
    let [a, b, c] = &lattices.feature_gradients;
    let own = [
        &buffers.step.params.raw,
        &lattices.levels.raw,
        &lattices.brick_index.raw,
        &batch.counters.raw,
        &batch.points.raw,
        &batch.slot_gradients.raw,
        &lattices.density_gradients.raw,
        &a.raw,
        &b.raw,
        &c.raw,
        &lattices.brick_marks.raw,
        &lattices.touched_bricks.raw,
    ];
    kernels.scatter.bind(device, &own)
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

fn step_bricks(device: &Device, kernels: &TrainKernels, buffers: Buffers<'_>) -> Bound {
    let lattices = buffers.lattices;
    let [a, b, c] = &lattices.features;
    let [by_a, by_b, by_c] = &lattices.feature_gradients;
    let own = [
        &buffers.step.params.raw,
        &buffers.step.state.raw,
        &lattices.touched_bricks.raw,
        &lattices.density.raw,
        &a.raw,
        &b.raw,
        &c.raw,
        &lattices.density_gradients.raw,
        &by_a.raw,
        &by_b.raw,
        &by_c.raw,
        &lattices.density_squares.raw,
        &lattices.feature_squares.raw,
        &lattices.brick_marks.raw,
    ];
    kernels.step_bricks.bind(device, &own)
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

fn variation(device: &Device, kernels: &TrainKernels, buffers: Buffers<'_>) -> Bound {
    let lattices = buffers.lattices;
    let [a, b, c] = &lattices.features;
    let [by_a, by_b, by_c] = &lattices.feature_gradients;
    let own = [
        &buffers.step.params.raw,
        &lattices.levels.raw,
        &lattices.brick_index.raw,
        &lattices.brick_places.raw,
        &lattices.touched_bricks.raw,
        &lattices.density.raw,
        &a.raw,
        &b.raw,
        &c.raw,
        &lattices.density_gradients.raw,
        &by_a.raw,
        &by_b.raw,
        &by_c.raw,
    ];
    kernels.variation.bind(device, &own)
}

fn smooth(device: &Device, kernels: &TrainKernels, buffers: Buffers<'_>) -> Bound {
    let lattices = buffers.lattices;
    let [a, b, c] = &lattices.features;
    let [by_a, by_b, by_c] = &lattices.feature_gradients;
    let own = [
        &buffers.step.params.raw,
        &buffers.step.state.raw,
        &lattices.touched_bricks.raw,
        &lattices.density.raw,
        &a.raw,
        &b.raw,
        &c.raw,
        &lattices.density_gradients.raw,
        &by_a.raw,
        &by_b.raw,
        &by_c.raw,
    ];
    kernels.smooth.bind(device, &own)
}
