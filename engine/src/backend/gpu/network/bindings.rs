//! Which buffers each of a colour network's kernels sees.

use backlot_shaders::layout;

use super::batch::NetworkBatch;
use super::kernels::NetworkKernels;
use super::{ResidentNetwork, layer_params};
use crate::backend::gpu::buffer::Buffer;
use crate::backend::gpu::device::Device;
use crate::backend::gpu::error::Error;
use crate::backend::gpu::pipeline::Pipeline;

/// All buffers that they see.
#[derive(Clone, Copy, Debug)]
pub(in crate::backend::gpu) struct NetworkBuffers<'a> {
    pub(in crate::backend::gpu) network: &'a ResidentNetwork,
    pub(in crate::backend::gpu) moments: &'a Buffer<layout::Moments>,
    pub(in crate::backend::gpu) batch: &'a NetworkBatch,
    pub(in crate::backend::gpu) counters: &'a Buffer<u32>,
    pub(in crate::backend::gpu) slot_colors: &'a Buffer<[f32; 4]>,
    pub(in crate::backend::gpu) slot_color_gradients: &'a Buffer<[f32; 4]>,
    pub(in crate::backend::gpu) params: &'a Buffer<layout::TrainParams>,
    pub(in crate::backend::gpu) state: &'a Buffer<layout::StepState>,
}

/// One bind group a kernel.
#[derive(Debug)]
pub(in crate::backend::gpu) struct NetworkBindings {
    pub(in crate::backend::gpu) forward: wgpu::BindGroup,
    pub(super) backward: wgpu::BindGroup,
    /// One a layer.
    pub(super) layer_gradients: [wgpu::BindGroup; 3],
    pub(super) step: wgpu::BindGroup,
}

impl NetworkBindings {
    pub(in crate::backend::gpu) fn new(
        device: &Device,
        kernels: &NetworkKernels,
        buffers: NetworkBuffers<'_>,
    ) -> Result<Self, Error> {
        Ok(Self {
            forward: forward(device, &kernels.forward, buffers)?,
            backward: backward(device, kernels, buffers)?,
            layer_gradients: layer_gradients(device, kernels, buffers)?,
            step: step(device, kernels, buffers)?,
        })
    }
}

type Bound = Result<wgpu::BindGroup, Error>;

/// Of any variant.
pub(in crate::backend::gpu) fn forward(
    device: &Device,
    kernel: &Pipeline,
    buffers: NetworkBuffers<'_>,
) -> Bound {
    let batch = buffers.batch;
    let [first, second, third] = &buffers.network.layers;
    let own = [
        &first.raw,
        &second.raw,
        &third.raw,
        &buffers.counters.raw,
        &batch.slot_inputs.raw,
        &batch.hidden[0].raw,
        &batch.hidden[1].raw,
        &buffers.slot_colors.raw,
    ];
    kernel.bind(device, &own)
}

fn backward(device: &Device, kernels: &NetworkKernels, buffers: NetworkBuffers<'_>) -> Bound {
    let batch = buffers.batch;
    let [first, second, third] = &buffers.network.layers;
    let own = [
        &first.raw,
        &second.raw,
        &third.raw,
        &buffers.counters.raw,
        &batch.hidden[0].raw,
        &batch.hidden[1].raw,
        &buffers.slot_colors.raw,
        &buffers.slot_color_gradients.raw,
        &batch.hidden_gradients[0].raw,
        &batch.hidden_gradients[1].raw,
        &batch.slot_gradients.raw,
    ];
    kernels.backward.bind(device, &own)
}

fn layer_gradients(
    device: &Device,
    kernels: &NetworkKernels,
    buffers: NetworkBuffers<'_>,
) -> Result<[wgpu::BindGroup; 3], Error> {
    let batch = buffers.batch;
    let [by_a, by_b] = &batch.hidden_gradients;
    let layers = layer_params(buffers.network.layout());
    let layer = |number: usize, inputs: &wgpu::Buffer, gradients: &wgpu::Buffer| {
        let own = [
            &batch.layers[number].raw,
            &buffers.counters.raw,
            inputs,
            gradients,
            &batch.weight_gradients.raw,
        ];
        let layer = &layers[number];
        kernels.layer_gradients(layer).bind(device, &own)
    };
    let by_out = &buffers.slot_color_gradients.raw;
    Ok([
        layer(0, &batch.slot_inputs.raw, &by_a.raw)?,
        layer(1, &batch.hidden[0].raw, &by_b.raw)?,
        layer(2, &batch.hidden[1].raw, by_out)?,
    ])
}

fn step(device: &Device, kernels: &NetworkKernels, buffers: NetworkBuffers<'_>) -> Bound {
    let own = [
        &buffers.params.raw,
        &buffers.state.raw,
        &buffers.batch.weight_gradients.raw,
        &buffers.moments.raw,
        &buffers.network.weights.raw,
    ];
    kernels.step.bind(device, &own)
}
