//! Which buffers each kernel of a step sees.

use super::batch::Batch;
use super::kernels::GridKernels;
use super::nodes::{Nodes, ValueNodes};
use super::{GridNetwork, StepBuffers};
use crate::backend::gpu::device::Device;
use crate::backend::gpu::error::Error;
use crate::backend::gpu::network::{NetworkBindings, NetworkBuffers};

/// All buffers of a grid.
#[derive(Clone, Copy, Debug)]
pub(super) struct Buffers<'a> {
    pub(super) nodes: &'a Nodes,
    pub(super) step: &'a StepBuffers,
    pub(super) network: Option<&'a GridNetwork>,
    pub(super) batch: &'a Batch,
}

/// One bind group a kernel.
#[derive(Debug)]
pub(super) struct Bindings {
    pub(super) march: wgpu::BindGroup,
    pub(super) gather: wgpu::BindGroup,
    pub(super) losses: wgpu::BindGroup,
    pub(super) network: Option<NetworkBindings>,
    pub(super) scatter: wgpu::BindGroup,
    pub(super) sum: wgpu::BindGroup,
    pub(super) wake: wgpu::BindGroup,
    pub(super) step_density: wgpu::BindGroup,
    /// One a quad.
    pub(super) step_quads: Vec<wgpu::BindGroup>,
}

type Bound = Result<wgpu::BindGroup, Error>;

impl Bindings {
    pub(super) fn new(
        device: &Device,
        kernels: &GridKernels,
        buffers: Buffers<'_>,
    ) -> Result<Self, Error> {
        Ok(Self {
            march: march(device, kernels, buffers)?,
            gather: gather(device, kernels, buffers)?,
            losses: losses(device, kernels, buffers)?,
            network: network(device, kernels, buffers)?,
            scatter: scatter(device, kernels, buffers)?,
            sum: sum(device, kernels, buffers)?,
            wake: wake(device, kernels, buffers)?,
            step_density: step_density(device, kernels, buffers)?,
            step_quads: step_quads(device, kernels, buffers)?,
        })
    }
}

fn march(device: &Device, kernels: &GridKernels, buffers: Buffers<'_>) -> Bound {
    let (nodes, batch) = (buffers.nodes, buffers.batch);
    let own = [
        &buffers.step.params.raw,
        &nodes.mask.raw,
        &nodes.density.values.raw,
        &batch.rays.raw,
        &batch.samples.raw,
        &batch.lights.raw,
        &batch.slots.raw,
        &batch.counters.raw,
    ];
    kernels.march.bind(device, &own)
}

fn gather(device: &Device, kernels: &GridKernels, buffers: Buffers<'_>) -> Bound {
    let (step, batch) = (buffers.step, buffers.batch);
    let quads: Vec<&wgpu::Buffer> = buffers.nodes.quads.iter().map(|q| &q.values.raw).collect();
    let mut own = vec![&step.params.raw];
    own.extend(quads);
    if let Some(network) = &batch.network {
        own.extend([&batch.rays.raw, &batch.samples.raw, &batch.slots.raw]);
        own.extend([&batch.counters.raw, &network.slot_inputs.raw]);
    } else {
        own.extend([&batch.samples.raw, &batch.slots.raw]);
        own.extend([&batch.counters.raw, &batch.slot_colors.raw]);
    }
    kernels.gather.bind(device, &own)
}

fn losses(device: &Device, kernels: &GridKernels, buffers: Buffers<'_>) -> Bound {
    let batch = buffers.batch;
    let own = [
        &buffers.step.params.raw,
        &batch.rays.raw,
        &batch.lights.raw,
        &batch.samples.raw,
        &batch.slot_colors.raw,
        &batch.slot_color_gradients.raw,
        &batch.points.raw,
        &batch.ray_losses.raw,
    ];
    kernels.losses.bind(device, &own)
}

fn network(
    device: &Device,
    kernels: &GridKernels,
    buffers: Buffers<'_>,
) -> Result<Option<NetworkBindings>, Error> {
    let batch = buffers.batch;
    let (Some(kernels), Some(network), Some(of_network)) =
        (&kernels.network, buffers.network, &batch.network)
    else {
        return Ok(None);
    };
    let own = NetworkBuffers {
        network: &network.resident,
        moments: &network.moments,
        batch: of_network,
        counters: &batch.counters,
        slot_colors: &batch.slot_colors,
        slot_color_gradients: &batch.slot_color_gradients,
        params: &buffers.step.train,
        state: &buffers.step.state,
    };
    NetworkBindings::new(device, kernels, own).map(Some)
}

fn scatter(device: &Device, kernels: &GridKernels, buffers: Buffers<'_>) -> Bound {
    let (nodes, batch) = (buffers.nodes, buffers.batch);
    // Where colours come from the grid itself their gradients are those of its values.
    let slot_gradients = match &batch.network {
        Some(network) => &network.slot_gradients.raw,
        None => &batch.slot_color_gradients.raw,
    };
    let quads = nodes.quads.iter().map(|quad| &quad.gradients.raw);
    let nothing = nodes.nothing.iter().map(|nothing| &nothing.raw);
    let mut own = vec![
        &buffers.step.params.raw,
        &batch.counters.raw,
        &batch.points.raw,
        slot_gradients,
        &nodes.density.gradients.raw,
    ];
    own.extend(quads.chain(nothing).take(3));
    own.push(&nodes.brick_seen.raw);
    kernels.scatter.bind(device, &own)
}

fn sum(device: &Device, kernels: &GridKernels, buffers: Buffers<'_>) -> Bound {
    let own = [
        &buffers.step.train.raw,
        &buffers.batch.ray_losses.raw,
        &buffers.batch.counters.raw,
        &buffers.step.state.raw,
    ];
    kernels.sum.bind(device, &own)
}

fn wake(device: &Device, kernels: &GridKernels, buffers: Buffers<'_>) -> Bound {
    let nodes = buffers.nodes;
    let own = [
        &buffers.step.params.raw,
        &nodes.brick_seen.raw,
        &nodes.brick_moved.raw,
        &nodes.brick_turns.raw,
    ];
    kernels.wake.bind(device, &own)
}

fn step_density(device: &Device, kernels: &GridKernels, buffers: Buffers<'_>) -> Bound {
    let all = step_buffers(buffers, &buffers.nodes.density);
    kernels.step_density.bind(device, &all)
}

fn step_quads(
    device: &Device,
    kernels: &GridKernels,
    buffers: Buffers<'_>,
) -> Result<Vec<wgpu::BindGroup>, Error> {
    let of_quad = |quad| kernels.step_quad.bind(device, &step_buffers(buffers, quad));
    buffers.nodes.quads.iter().map(of_quad).collect()
}

/// What moves one kind of values.
fn step_buffers<'a, T>(buffers: Buffers<'a>, own: &'a ValueNodes<T>) -> [&'a wgpu::Buffer; 8] {
    let nodes = buffers.nodes;
    [
        &buffers.step.params.raw,
        &buffers.step.state.raw,
        &nodes.brick_turns.raw,
        &nodes.shares.raw,
        &own.values.raw,
        &own.gradients.raw,
        &own.means.raw,
        &own.squares.raw,
    ]
}
