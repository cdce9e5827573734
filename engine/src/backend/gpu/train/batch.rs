//! What a batch of rays needs between its kernels.

use backlot_shaders::layout;
use wgpu::BufferUsages;

use crate::backend::gpu::buffer::Buffer;
use crate::backend::gpu::device::Device;
use crate::backend::gpu::error::Error;
use crate::backend::gpu::network::NetworkBatch;
use crate::backend::gpu::network::batch::{gradient_shares, most_slots, padded};
use crate::field::Field;
use crate::field::mlp::MlpLayout;

/// Samples of one ray, at most: what is left of a ray with as many is behind hundreds of metres of occupied space.
const SAMPLES_PER_RAY: u32 = 1024;

type Quad = [f32; 4];

/// How much work is handed out at once.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Capacity {
    /// Rays of a batch.
    pub(super) rays: u32,
    pub(super) samples_per_ray: u32,
    /// Rays of a whole step.
    pub(super) step_rays: u32,
    /// Shares of the samples whose weight gradients are summed apart.
    pub(super) shares: u32,
}

impl Capacity {
    /// As many rays as can never fill more than the adapter's share of hidden activations, nor any buffer more than a binding.
    pub(super) fn new(
        device: &Device,
        network: MlpLayout,
        samples_per_ray: u32,
        step_rays: usize,
    ) -> Self {
        let samples = most_slots(device, network);
        let step_rays = step_rays.max(1) as u32;
        Self {
            rays: (samples / samples_per_ray).clamp(1, step_rays),
            samples_per_ray,
            step_rays,
            shares: gradient_shares(device),
        }
    }

    /// Whether buffers of this capacity do for another one.
    pub(super) fn holds(self, other: Self) -> bool {
        self.rays >= other.rays
            && self.samples_per_ray >= other.samples_per_ray
            && self.step_rays >= other.step_rays
    }
}

/// Samples of a ray, at most: each is a shortest step, but for the last.
pub(super) fn most_samples(field: &Field) -> u32 {
    let (low, high) = field.bounds();
    let steps = field
        .occupancy()
        .steps_m()
        .iter()
        .filter(|step| **step > 0.0);
    let shortest_m = steps.copied().fold(f32::INFINITY, f32::min);
    (((high - low).length() / shortest_m) as u32 + 2).min(SAMPLES_PER_RAY)
}

/// Buffers of one batch, reused by the next.
#[derive(Debug)]
pub(super) struct Batch {
    pub(super) capacity: Capacity,
    pub(super) rays: Buffer<layout::Ray>,
    pub(super) targets: Buffer<layout::RayTarget>,
    pub(super) summaries: Buffer<layout::RaySummary>,
    pub(super) samples: Buffer<layout::RaySample>,
    pub(super) weights: Buffer<f32>,
    pub(super) slots: Buffer<u32>,
    pub(super) first_points: Buffer<u32>,
    pub(super) points: Buffer<layout::GradientPoint>,
    pub(super) slot_samples: Buffer<layout::SlotSample>,
    pub(super) slot_colors: Buffer<Quad>,
    pub(super) slot_color_gradients: Buffer<Quad>,
    pub(super) network: NetworkBatch,
    /// Coloured samples and points of the batch, then of the step.
    pub(super) counters: Buffer<u32>,
    /// Of the whole step.
    pub(super) ray_losses: Buffer<layout::RayLoss>,
}

impl Batch {
    /// A step's parameters as this batch's kernels need them.
    pub(super) fn params(&self, params: layout::TrainParams) -> layout::TrainParams {
        layout::TrainParams {
            sample_capacity: self.capacity.samples_per_ray,
            ..params
        }
    }

    pub(super) fn new(
        device: &Device,
        capacity: Capacity,
        network: MlpLayout,
    ) -> Result<Self, Error> {
        let rays = capacity.rays as usize;
        let samples = rays * capacity.samples_per_ray as usize;
        let step_rays = capacity.step_rays as usize;
        let slots = padded(samples);
        let storage = BufferUsages::STORAGE;
        Ok(Self {
            capacity,
            rays: Buffer::zeroed(device, "rays", rays, storage)?,
            targets: Buffer::zeroed(device, "ray targets", rays, storage)?,
            summaries: Buffer::zeroed(device, "ray summaries", rays, storage)?,
            samples: Buffer::zeroed(device, "ray samples", samples, storage)?,
            weights: Buffer::zeroed(device, "sample weights", samples, storage)?,
            slots: Buffer::zeroed(device, "sample slots", samples, storage)?,
            first_points: Buffer::zeroed(device, "first points", rays, storage)?,
            points: Buffer::zeroed(device, "gradient points", samples, storage)?,
            slot_samples: Buffer::zeroed(device, "slot samples", slots, storage)?,
            slot_colors: Buffer::zeroed(device, "slot colours", slots, storage)?,
            slot_color_gradients: Buffer::zeroed(device, "slot colour gradients", slots, storage)?,
            network: NetworkBatch::new(device, network, samples, capacity.shares)?,
            counters: Buffer::zeroed(device, "counters", 4, storage)?,
            ray_losses: Buffer::zeroed(device, "ray losses", step_rays, storage)?,
        })
    }
}
