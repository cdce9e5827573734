//! Which buffers the kernels see that take the nodes part by part.

use super::bindings::{Bound, Buffers};
use super::kernels::TrainKernels;
use super::lattices::Lattices;
use crate::backend::gpu::device::Device;
use crate::backend::gpu::error::Error;
use crate::backend::gpu::features::{QUADS, Quad};
use crate::backend::gpu::parts::Parts;

/// The kernels' bind groups for one part of the nodes.
#[derive(Debug)]
pub(super) struct NodeBindings {
    pub(super) gather: wgpu::BindGroup,
    pub(super) scatter: wgpu::BindGroup,
    pub(super) poses: wgpu::BindGroup,
    pub(super) step_bricks: wgpu::BindGroup,
    /// One a part of the neighbours.
    pub(super) variation: Vec<wgpu::BindGroup>,
    pub(super) smooth: wgpu::BindGroup,
}

/// A part's buffers.
#[derive(Clone, Copy, Debug)]
struct Part<'a> {
    params: &'a wgpu::Buffer,
    /// Those that hold the part's.
    density: &'a wgpu::Buffer,
    features: [&'a wgpu::Buffer; QUADS],
    density_gradients: &'a wgpu::Buffer,
    feature_gradients: [&'a wgpu::Buffer; QUADS],
    density_squares: &'a wgpu::Buffer,
    feature_squares: &'a wgpu::Buffer,
}

impl<'a> Part<'a> {
    fn of(lattices: &'a Lattices, number: usize) -> Self {
        let first = number * lattices.features[0].nodes_per_part();
        let quads = |of: &'a [Parts<Quad>; QUADS]| -> [&'a wgpu::Buffer; QUADS] {
            std::array::from_fn(|quad| &of[quad].parts()[number].raw)
        };
        Self {
            params: &lattices.parts[number].raw,
            density: &lattices.shape.density.holding(first).0.raw,
            features: quads(&lattices.features),
            density_gradients: &lattices.density_gradients.parts()[number].raw,
            feature_gradients: quads(&lattices.feature_gradients),
            density_squares: &lattices.density_squares.parts()[number].raw,
            feature_squares: &lattices.feature_squares.parts()[number].raw,
        }
    }
}

impl<'a> Part<'a> {
    /// What a kernel sees first that moves nodes against their gradients.
    fn moved(self, buffers: Buffers<'a>) -> [&'a wgpu::Buffer; 12] {
        let [a, b, c] = self.features;
        let [by_a, by_b, by_c] = self.feature_gradients;
        [
            &buffers.step.params.raw,
            self.params,
            &buffers.step.state.raw,
            &buffers.lattices.touched_bricks.raw,
            self.density,
            a,
            b,
            c,
            self.density_gradients,
            by_a,
            by_b,
            by_c,
        ]
    }
}

impl NodeBindings {
    pub(super) fn new(
        device: &Device,
        kernels: &TrainKernels,
        buffers: Buffers<'_>,
        number: usize,
    ) -> Result<Self, Error> {
        let part = Part::of(buffers.lattices, number);
        let others = (0..buffers.lattices.parts.len()).map(|n| Part::of(buffers.lattices, n));
        Ok(Self {
            gather: gather(device, kernels, buffers, part)?,
            scatter: scatter(device, kernels, buffers, part)?,
            poses: poses(device, kernels, buffers, part)?,
            step_bricks: step_bricks(device, kernels, buffers, part)?,
            variation: others
                .map(|other| variation(device, kernels, buffers, part, other))
                .collect::<Result<_, _>>()?,
            smooth: smooth(device, kernels, buffers, part)?,
        })
    }
}

fn gather(device: &Device, kernels: &TrainKernels, buffers: Buffers<'_>, part: Part<'_>) -> Bound {
    let (shape, batch) = (&buffers.lattices.shape, buffers.batch);
    let [a, b, c] = part.features;
    let own = [
        part.params,
        &shape.levels.raw,
        &shape.brick_index.raw,
        a,
        b,
        c,
        &batch.rays.raw,
        &batch.slot_samples.raw,
        &batch.counters.raw,
        &batch.network.slot_inputs.raw,
    ];
    kernels.gather.bind(device, &own)
}

fn scatter(device: &Device, kernels: &TrainKernels, buffers: Buffers<'_>, part: Part<'_>) -> Bound {
    let (lattices, batch) = (buffers.lattices, buffers.batch);
    let [a, b, c] = part.feature_gradients;
    let own = [
        part.params,
        &lattices.shape.levels.raw,
        &lattices.shape.brick_index.raw,
        &batch.counters.raw,
        &batch.points.raw,
        &batch.network.slot_gradients.raw,
        part.density_gradients,
        a,
        b,
        c,
        &lattices.brick_marks.raw,
        &lattices.touched_bricks.raw,
    ];
    kernels.scatter.bind(device, &own)
}

fn poses(device: &Device, kernels: &TrainKernels, buffers: Buffers<'_>, part: Part<'_>) -> Bound {
    let (shape, batch) = (&buffers.lattices.shape, buffers.batch);
    let [a, b, c] = part.features;
    let own = [
        &buffers.step.params.raw,
        part.params,
        &shape.levels.raw,
        &shape.brick_index.raw,
        part.density,
        a,
        b,
        c,
        &batch.targets.raw,
        &batch.summaries.raw,
        &batch.first_points.raw,
        &batch.points.raw,
        &batch.network.slot_gradients.raw,
        &buffers.views.views.raw,
        &buffers.views.sums.raw,
    ];
    kernels.poses.bind(device, &own)
}

fn step_bricks(
    device: &Device,
    kernels: &TrainKernels,
    buffers: Buffers<'_>,
    part: Part<'_>,
) -> Bound {
    let more = [
        part.density_squares,
        part.feature_squares,
        &buffers.lattices.brick_marks.raw,
    ];
    let own = [&part.moved(buffers)[..], &more].concat();
    kernels.step_bricks.bind(device, &own)
}

fn variation(
    device: &Device,
    kernels: &TrainKernels,
    buffers: Buffers<'_>,
    part: Part<'_>,
    other: Part<'_>,
) -> Bound {
    let lattices = buffers.lattices;
    let [a, b, c] = part.features;
    let [other_a, other_b, other_c] = other.features;
    let [by_a, by_b, by_c] = part.feature_gradients;
    let own = [
        &buffers.step.params.raw,
        part.params,
        other.params,
        &lattices.shape.levels.raw,
        &lattices.shape.brick_index.raw,
        &lattices.brick_places.raw,
        &lattices.touched_bricks.raw,
        part.density,
        a,
        b,
        c,
        other.density,
        other_a,
        other_b,
        other_c,
        part.density_gradients,
        by_a,
        by_b,
        by_c,
    ];
    kernels.variation.bind(device, &own)
}

fn smooth(device: &Device, kernels: &TrainKernels, buffers: Buffers<'_>, part: Part<'_>) -> Bound {
    kernels.smooth.bind(device, &part.moved(buffers))
}
