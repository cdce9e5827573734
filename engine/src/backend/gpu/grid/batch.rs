//! What a batch of rays needs between its kernels.

use backlot_shaders::{grid_layout, layout};
use wgpu::BufferUsages;

use crate::backend::gpu::buffer::Buffer;
use crate::backend::gpu::device::Device;
use crate::backend::gpu::error::Error;
use crate::backend::gpu::network::NetworkBatch;
use crate::backend::gpu::network::batch::{gradient_shares, most_slots, padded};
use crate::field::mlp::MlpLayout;
use crate::train::dvgo::Stage;

type Quad = [f32; 4];

/// Of a sample, and of a point: the most that a sample takes of one buffer where there is no network.
const BYTES_PER_SAMPLE: u64 = size_of::<grid_layout::GridSample>() as u64;
/// Samples of a batch without a network, at most: 32 MiB a buffer.
const MOST_SAMPLES: u64 = 1 << 20;

/// How much work is handed out at once.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Capacity {
    /// Rays of a batch.
    pub(super) rays: u32,
    pub(super) samples_per_ray: u32,
    /// Rays of a whole step.
    step_rays: u32,
    /// Shares of the samples whose weight gradients are summed apart.
    pub(super) shares: u32,
}

impl Capacity {
    /// As many rays as can never fill more than a batch's share of the adapter.
    pub(super) fn new<const C: usize>(
        device: &Device,
        stage: &Stage<C>,
        network: Option<MlpLayout>,
    ) -> Self {
        let samples = match network {
            Some(network) => most_slots(device, network),
            None => MOST_SAMPLES.min(device.max_binding_bytes() / BYTES_PER_SAMPLE) as u32,
        };
        let samples_per_ray = most_samples(stage);
        let step_rays = stage.recipe.rays.max(1) as u32;
        Self {
            rays: (samples / samples_per_ray).clamp(1, step_rays),
            samples_per_ray,
            step_rays,
            shares: gradient_shares(device),
        }
    }
}

/// Samples of a ray, at most: those that fit into the box's diagonal, one at its start and one for rounding.
fn most_samples<const C: usize>(stage: &Stage<C>) -> u32 {
    let diagonal_m = (stage.shape.high - stage.shape.low).length();
    (diagonal_m / stage.step_m()).ceil() as u32 + 2
}

/// Buffers of one batch, reused by the next.
#[derive(Debug)]
pub(super) struct Batch {
    pub(super) capacity: Capacity,
    pub(super) rays: Buffer<grid_layout::PixelRay>,
    pub(super) samples: Buffer<grid_layout::GridSample>,
    pub(super) lights: Buffer<grid_layout::RayLight>,
    pub(super) slots: Buffer<grid_layout::GridSlot>,
    pub(super) points: Buffer<grid_layout::GridPoint>,
    pub(super) slot_colors: Buffer<Quad>,
    pub(super) slot_color_gradients: Buffer<Quad>,
    pub(super) network: Option<NetworkBatch>,
    /// Coloured samples and points of the batch, then of the step.
    pub(super) counters: Buffer<u32>,
    /// Of the whole step.
    pub(super) ray_losses: Buffer<layout::RayLoss>,
}

impl Batch {
    pub(super) fn new(
        device: &Device,
        capacity: Capacity,
        network: Option<MlpLayout>,
    ) -> Result<Self, Error> {
        let rays = capacity.rays as usize;
        let samples = rays * capacity.samples_per_ray as usize;
        let step_rays = capacity.step_rays as usize;
        let slots = padded(samples);
        let storage = BufferUsages::STORAGE;
        let of_network = |network| NetworkBatch::new(device, network, samples, capacity.shares);
        Ok(Self {
            capacity,
            rays: Buffer::zeroed(device, "pixel rays", rays, storage)?,
            samples: Buffer::zeroed(device, "grid samples", samples, storage)?,
            lights: Buffer::zeroed(device, "light of rays", rays, storage)?,
            slots: Buffer::zeroed(device, "grid slots", slots, storage)?,
            points: Buffer::zeroed(device, "grid points", samples, storage)?,
            slot_colors: Buffer::zeroed(device, "slot colours", slots, storage)?,
            slot_color_gradients: Buffer::zeroed(device, "slot colour gradients", slots, storage)?,
            network: network.map(of_network).transpose()?,
            counters: Buffer::zeroed(device, "counters", 4, storage)?,
            ray_losses: Buffer::zeroed(device, "ray losses", step_rays, storage)?,
        })
    }
}
