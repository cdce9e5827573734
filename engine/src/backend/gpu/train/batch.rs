//! What a batch of rays needs between its kernels.

use backlot_shaders::layout;
use wgpu::BufferUsages;

use super::network::{Block, weight_blocks};
use crate::backend::gpu::buffer::Buffer;
use crate::backend::gpu::device::Device;
use crate::backend::gpu::error::Error;
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
    /// Threads of the backward pass, each of which has gradients of all weights.
    pub(super) backward_threads: u32,
}

impl Capacity {
    pub(super) fn new(device: &Device, samples_per_ray: u32, step_rays: usize) -> Self {
        // A processor wants a batch in its caches, a GPU wants many rays.
        let (rays, backward_threads) = if device.is_software() {
            (1024, 64)
        } else {
            (4096, 2048)
        };
        let step_rays = step_rays.max(1) as u32;
        Self {
            rays: step_rays.min(rays),
            samples_per_ray,
            step_rays,
            backward_threads,
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
    /// Three quads a slot: features, and after the backward pass their gradients.
    pub(super) slot_features: Buffer<Quad>,
    pub(super) slot_colors: Buffer<Quad>,
    pub(super) slot_color_gradients: Buffer<Quad>,
    pub(super) weight_gradients: Buffer<Block>,
    /// Coloured samples and points of the batch, then of the step.
    pub(super) counters: Buffer<u32>,
    /// Of the whole step.
    pub(super) ray_losses: Buffer<layout::RayLoss>,
    pub(super) exposure_gradients: Buffer<layout::ExposureGradient>,
}

impl Batch {
    pub(super) fn new(
        device: &Device,
        capacity: Capacity,
        network: MlpLayout,
    ) -> Result<Self, Error> {
        let rays = capacity.rays as usize;
        let samples = rays * capacity.samples_per_ray as usize;
        let step_rays = capacity.step_rays as usize;
        let blocks = capacity.backward_threads as usize * weight_blocks(network);
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
            slot_samples: Buffer::zeroed(device, "slot samples", samples, storage)?,
            slot_features: Buffer::zeroed(device, "slot features", 3 * samples, storage)?,
            slot_colors: Buffer::zeroed(device, "slot colours", samples, storage)?,
            slot_color_gradients: Buffer::zeroed(
                device,
                "slot colour gradients",
                samples,
                storage,
            )?,
            weight_gradients: Buffer::zeroed(device, "weight gradients", blocks, storage)?,
            counters: Buffer::zeroed(device, "counters", 4, storage)?,
            ray_losses: Buffer::zeroed(device, "ray losses", step_rays, storage)?,
            exposure_gradients: Buffer::zeroed(device, "exposure gradients", step_rays, storage)?,
        })
    }
}
