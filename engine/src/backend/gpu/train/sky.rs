//! The sky map with its gradients and optimiser state in device buffers.

use backlot_shaders::layout;
use wgpu::BufferUsages;

use crate::backend::gpu::buffer::Buffer;
use crate::backend::gpu::device::Device;
use crate::backend::gpu::error::Error;
use crate::field::{Field, SkyGrid};

/// All grids, texel after texel; one unused texel where there is no sky.
#[derive(Debug)]
pub(super) struct Sky {
    pub(super) grids: Buffer<layout::SkyGrid>,
    /// Three logits a texel.
    pub(super) logits: Buffer<f32>,
    pub(super) gradients: Buffer<f32>,
    pub(super) squares: Buffer<f32>,
}

impl Sky {
    pub(super) fn upload(device: &Device, field: &Field) -> Result<Self, Error> {
        let storage = BufferUsages::STORAGE;
        let grids = grids(field);
        let mut start = 0;
        let shapes: Vec<layout::SkyGrid> = grids
            .iter()
            .map(|grid| {
                let shape = layout::SkyGrid {
                    width: grid.width(),
                    height: grid.height(),
                    start,
                };
                start += grid.logits().len() as u32;
                shape
            })
            .collect();
        let logits: Vec<f32> = grids
            .iter()
            .flat_map(|grid| grid.logits().as_flattened())
            .copied()
            .collect();
        let texels = (start as usize).max(1);
        Ok(Self {
            grids: Buffer::from_slice(device, "sky grids", &shapes, storage)?,
            logits: Buffer::from_slice(device, "sky logits", &logits, storage)?,
            gradients: Buffer::zeroed(device, "sky gradients", 3 * texels, storage)?,
            squares: Buffer::zeroed(device, "sky squares", texels, storage)?,
        })
    }

    pub(super) fn fetch(&self, device: &Device, field: &mut Field) -> Result<(), Error> {
        let Some(sky) = &mut field.sky else {
            return Ok(());
        };
        let logits = self.logits.read(device, self.logits.len())?;
        let mut texels = logits.as_chunks::<3>().0;
        for grid in sky.grids_mut() {
            let (own, rest) = texels.split_at(grid.logits().len());
            grid.logits_mut().copy_from_slice(own);
            texels = rest;
        }
        Ok(())
    }
}

fn grids(field: &Field) -> &[SkyGrid] {
    field.sky.as_ref().map_or(&[], |sky| sky.grids())
}
