//! Small buffers that outlive a step.

use backlot_shaders::{BLOCK_FLOATS, layout};
use wgpu::BufferUsages;

use crate::backend::gpu::buffer::Buffer;
use crate::backend::gpu::device::Device;
use crate::backend::gpu::error::Error;
use crate::backend::gpu::network::weight_blocks;
use crate::field::mlp::MlpLayout;

#[derive(Debug)]
pub(super) struct StepBuffers {
    pub(super) params: Buffer<layout::TrainParams>,
    pub(super) state: Buffer<layout::StepState>,
    /// Of the colour network's optimiser.
    pub(super) moments: Buffer<layout::Moments>,
}

impl StepBuffers {
    pub(super) fn new(device: &Device, network: MlpLayout) -> Result<Self, Error> {
        let start = layout::StepState {
            depth_trim_m: f32::MAX,
            ..layout::StepState::default()
        };
        let storage = BufferUsages::STORAGE;
        let weights = weight_blocks(network) * BLOCK_FLOATS;
        Ok(Self {
            params: Buffer::zeroed(device, "train parameters", 1, BufferUsages::UNIFORM)?,
            state: Buffer::from_slice(device, "step state", &[start], storage)?,
            moments: Buffer::zeroed(device, "network moments", weights, storage)?,
        })
    }
}
