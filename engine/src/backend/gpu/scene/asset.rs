//! A field in device buffers with all that rendering needs.

use backlot_shaders::layout;
use wgpu::BufferUsages;

use crate::backend::gpu::buffer::Buffer;
use crate::backend::gpu::device::Device;
use crate::backend::gpu::error::Error;
use crate::backend::gpu::features::{self, QUADS, Quad};
use crate::backend::gpu::field::ResidentField;
use crate::backend::gpu::network::ResidentNetwork;
use crate::backend::gpu::parts::Parts;
use crate::backend::gpu::transfer::Transfer;
use crate::field::mlp::MlpLayout;
use crate::field::{Field, SkyMap};

/// Density, features, colour network and sky.
#[derive(Debug)]
pub(super) struct ResidentAsset {
    pub(super) shape: ResidentField,
    pub(super) features: [Parts<Quad>; QUADS],
    pub(super) network: ResidentNetwork,
    pub(super) network_layout: MlpLayout,
    pub(super) sky: Option<ResidentSky>,
}

#[derive(Debug)]
pub(super) struct ResidentSky {
    pub(super) grids: Buffer<layout::SkyGrid>,
    pub(super) logits: Buffer<f32>,
    pub(super) grid_count: u32,
}

impl ResidentAsset {
    /// # Errors
    /// [`Error::TooLarge`] where a buffer outgrows the adapter's bindings, [`Error::OutOfMemory`] where the device is full, and those
    /// of [`Transfer::go_on`].
    pub(super) fn upload(upload: Transfer<'_>, field: &Field) -> Result<Self, Error> {
        let device = upload.device;
        Ok(Self {
            shape: ResidentField::upload(upload, field)?,
            features: features::upload(upload, field.levels())?,
            network: ResidentNetwork::upload(device, field.mlp())?,
            network_layout: field.mlp().layout(),
            sky: field
                .sky
                .as_ref()
                .map(|sky| ResidentSky::upload(device, sky))
                .transpose()?,
        })
    }

    /// What [`Self::upload`] will take of the device, but for the network and small tables.
    pub(super) fn bytes_of(field: &Field) -> u64 {
        field.memory_bytes()
    }
}

impl ResidentSky {
    fn upload(device: &Device, sky: &SkyMap) -> Result<Self, Error> {
        let mut grids = Vec::new();
        let mut logits = Vec::new();
        for grid in sky.grids() {
            grids.push(layout::SkyGrid {
                width: grid.width(),
                height: grid.height(),
                start: (logits.len() / 3) as u32,
            });
            logits.extend_from_slice(grid.logits().as_flattened());
        }
        let storage = BufferUsages::STORAGE;
        Ok(Self {
            grid_count: grids.len() as u32,
            grids: Buffer::from_slice(device, "sky grids", &grids, storage)?,
            logits: Buffer::from_slice(device, "sky logits", &logits, storage)?,
        })
    }
}
