//! A field in device buffers with all that rendering needs.

use backlot_shaders::layout;
use wgpu::BufferUsages;

use crate::backend::gpu::buffer::Buffer;
use crate::backend::gpu::device::Device;
use crate::backend::gpu::error::Error;
use crate::backend::gpu::field::ResidentField;
use crate::backend::gpu::parts::Parts;
use crate::backend::gpu::train::network::ResidentNetwork;
use crate::field::mlp::MlpLayout;
use crate::field::{BRICK_NODES, FEATURES, Field, Lattice, SkyMap};

/// Density, features, colour network and sky.
#[derive(Debug)]
pub(super) struct ResidentAsset {
    pub(super) shape: ResidentField,
    /// Quads of features: buffers of their own, so that few outgrow a binding.
    pub(super) features: [Parts<[f32; 4]>; FEATURES / 4],
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
    /// [`Error::TooLarge`] where a buffer outgrows the adapter's bindings, [`Error::OutOfMemory`] where the device is full.
    pub(super) fn upload(device: &Device, field: &Field) -> Result<Self, Error> {
        Ok(Self {
            shape: ResidentField::upload(device, field)?,
            features: [
                quad(device, "features a", field.levels(), 0)?,
                quad(device, "features b", field.levels(), 1)?,
                quad(device, "features c", field.levels(), 2)?,
            ],
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

/// One quad of all nodes, levels one after the other with one null brick before them, as the bricks are numbered.
fn quad(
    device: &Device,
    label: &'static str,
    levels: &[Lattice],
    number: usize,
) -> Result<Parts<[f32; 4]>, Error> {
    let stored = levels
        .iter()
        .map(|level| level.features().len() - BRICK_NODES);
    let nodes = BRICK_NODES + stored.sum::<usize>();
    let quads = Parts::zeroed(device, label, nodes, MOST_PARTS)?;
    let mut at = BRICK_NODES;
    let mut values = Vec::with_capacity(NODES_PER_WRITE);
    for level in levels {
        for part in level.features()[BRICK_NODES..].chunks(NODES_PER_WRITE) {
            values.clear();
            values.extend(part.iter().map(|node| node.as_chunks::<4>().0[number]));
            quads.write(device, at, &values);
            at += part.len();
            // Staging memory of what was written goes back before more is taken.
            device.flush()?;
        }
    }
    Ok(quads)
}

/// Parts are gathered one after the other: more would be slower than the processor.
const MOST_PARTS: usize = 32;
/// 4 MiB at a time: the transposed copy of a dense background would take half a gigabyte a quad.
const NODES_PER_WRITE: usize = 1 << 18;

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
