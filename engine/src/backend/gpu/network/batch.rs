//! What a colour network needs between its kernels for one batch of samples.

use backlot_shaders::{INPUT_BLOCKS, SLOTS_AT_ONCE, layout};
use wgpu::BufferUsages;

use super::{Block, layer_params, weight_blocks, width_blocks};
use crate::backend::gpu::buffer::Buffer;
use crate::backend::gpu::device::Device;
use crate::backend::gpu::error::Error;
use crate::field::mlp::MlpLayout;

type Quad = [f32; 4];

/// The network's inputs: the most that a slot takes of one buffer, but for the activations of wide networks.
const BYTES_PER_SLOT: u64 = (INPUT_BLOCKS * size_of::<Quad>()) as u64;

/// Buffers of one batch, reused by the next.
#[derive(Debug)]
pub(in crate::backend::gpu) struct NetworkBatch {
    /// Ten quads a slot.
    pub(in crate::backend::gpu) slot_inputs: Buffer<Quad>,
    /// By the features, three quads a slot.
    pub(in crate::backend::gpu) slot_gradients: Buffer<Quad>,
    /// Activations of the two hidden layers and gradients by them.
    pub(super) hidden: [Buffer<Quad>; 2],
    pub(super) hidden_gradients: [Buffer<Quad>; 2],
    pub(in crate::backend::gpu) weight_gradients: Buffer<Block>,
    pub(super) layers: [Buffer<layout::LayerParams>; 3],
}

impl NetworkBatch {
    /// Buffers for `slots` samples, whose weights' gradients are summed in `shares`.
    pub(in crate::backend::gpu) fn new(
        device: &Device,
        network: MlpLayout,
        slots: usize,
        shares: u32,
    ) -> Result<Self, Error> {
        let storage = BufferUsages::STORAGE;
        let blocks = shares as usize * weight_blocks(network);
        let slots = padded(slots);
        let neurons = slots * width_blocks(network);
        let layer = |params: &layout::LayerParams| {
            let params = layout::LayerParams { shares, ..*params };
            Buffer::from_slice(device, "layer", &[params], BufferUsages::UNIFORM)
        };
        let [first, second, third] = layer_params(network);
        Ok(Self {
            slot_inputs: Buffer::zeroed(device, "slot inputs", INPUT_BLOCKS * slots, storage)?,
            slot_gradients: Buffer::zeroed(device, "slot gradients", 3 * slots, storage)?,
            hidden: [
                Buffer::zeroed(device, "hidden layer 1", neurons, storage)?,
                Buffer::zeroed(device, "hidden layer 2", neurons, storage)?,
            ],
            hidden_gradients: [
                Buffer::zeroed(device, "gradients of hidden layer 1", neurons, storage)?,
                Buffer::zeroed(device, "gradients of hidden layer 2", neurons, storage)?,
            ],
            layers: [layer(&first)?, layer(&second)?, layer(&third)?],
            weight_gradients: Buffer::zeroed(device, "weight gradients", blocks, storage)?,
        })
    }
}

/// Slots with those past the last that kernels which take many at once write.
pub(in crate::backend::gpu) fn padded(slots: usize) -> usize {
    slots.next_multiple_of(SLOTS_AT_ONCE as usize)
}

/// Samples of a batch, at most: no more than the adapter's share of hidden activations, nor any buffer more than a binding.
pub(in crate::backend::gpu) fn most_slots(device: &Device, network: MlpLayout) -> u32 {
    // A processor wants a batch near its caches, a GPU wants many samples.
    let hidden_bytes: u64 = if device.is_software() {
        32 << 20
    } else {
        256 << 20
    };
    let width_bytes = (network.width * size_of::<f32>()) as u64;
    let widest = width_bytes.max(BYTES_PER_SLOT);
    let slots = (hidden_bytes / width_bytes).min(device.max_binding_bytes() / widest);
    let slots = slots.saturating_sub(u64::from(SLOTS_AT_ONCE) - 1);
    u32::try_from(slots).unwrap_or(u32::MAX)
}

/// Shares of the samples whose weight gradients are summed apart. Every share is read and written once a batch.
pub(in crate::backend::gpu) fn gradient_shares(device: &Device) -> u32 {
    device
        .processors()
        .map_or(64, |processors| processors.clamp(2, 8))
}
