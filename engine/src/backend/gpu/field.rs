//! A field in device buffers.

use std::sync::Arc;

use backlot_shaders::{Kernel, layout};
use wgpu::BufferUsages;

use super::buffer::Buffer;
use super::device::Device;
use super::error::Error;
use super::features::node_count;
use super::parts::Parts;
use super::pipeline::Pipeline;
use super::transfer::{NODES_PER_COPY, Transfer};
use crate::field::march::{FACE_NUDGE, SIGMA_MIN};
use crate::field::{BRICK_NODES, Field, Lattice, NULL_BRICK, Occupancy};

const _: () = assert!(
    BRICK_NODES
        == (backlot_shaders::BRICK_SIDE * backlot_shaders::BRICK_SIDE * backlot_shaders::BRICK_SIDE)
            as usize,
    "kernels and fields agree on the brick"
);

/// Density and occupancy of a field. All levels share one brick numbering, whose brick 0 is the null brick of each.
#[derive(Debug)]
pub(super) struct ResidentField {
    pub(super) levels: Buffer<layout::Level>,
    pub(super) brick_index: Buffer<u32>,
    pub(super) density: Parts<f32>,
    pub(super) block_index: Buffer<u32>,
    pub(super) blocks: Buffer<layout::Block>,
    /// The field's constants; the dispatch's fields are zero.
    pub(super) params: layout::MarchParams,
    pub(super) bytes: u64,
}

impl ResidentField {
    /// # Errors
    /// [`Error::TooLarge`] or [`Error::OutOfMemory`] where it does not fit, and those of [`Transfer::go_on`].
    pub(super) fn upload(upload: Transfer<'_>, field: &Field) -> Result<Self, Error> {
        let device = upload.device;
        let pyramid = index(field.levels());
        let occupancy = field.occupancy();
        let blocks = blocks(occupancy);
        let storage = BufferUsages::STORAGE;
        let density = density(upload, field.levels())?;
        let resident = Self {
            levels: Buffer::from_slice(device, "levels", &pyramid.levels, storage)?,
            brick_index: Buffer::from_slice(device, "brick index", &pyramid.brick_index, storage)?,
            density,
            block_index: Buffer::from_slice(device, "occupancy index", occupancy.index(), storage)?,
            blocks: Buffer::from_slice(device, "occupancy blocks", &blocks, storage)?,
            params: params(field),
            bytes: 0,
        };
        let bytes = resident.levels.bytes()
            + resident.brick_index.bytes()
            + resident.density.bytes()
            + resident.block_index.bytes()
            + resident.blocks.bytes();
        Ok(Self { bytes, ..resident })
    }

    /// The variant of a kernel that reads densities as this field has them: `whole`, or `split` over several bindings.
    ///
    /// # Errors
    /// As [`Pipeline::with`].
    pub(super) fn kernel(
        &self,
        device: &Device,
        whole: &Kernel,
        split: &Kernel,
    ) -> Result<Arc<Pipeline>, Error> {
        if self.density.parts().len() == 1 {
            return device.pipeline(whole, &[]);
        }
        let nodes = self.density.nodes_per_part() as f64;
        device.pipeline(split, &[("NODES_PER_PART", nodes)])
    }

    /// Where densities begin.
    pub(super) fn first_density(&self) -> &wgpu::Buffer {
        &self.density.parts()[0].raw
    }

    /// The buffers that a kernel of split densities binds besides; none if they are whole.
    pub(super) fn other_densities(&self) -> Vec<&wgpu::Buffer> {
        let parts = self.density.parts();
        if parts.len() == 1 {
            return Vec::new();
        }
        // Bindings cannot be empty; no node lies in those that repeat.
        let part = |i: usize| &parts.get(i).unwrap_or(&parts[0]).raw;
        (1..backlot_shaders::DENSITY_PARTS).map(part).collect()
    }
}

/// Densities of all levels, one after the other after one null brick.
fn density(upload: Transfer<'_>, levels: &[Lattice]) -> Result<Parts<f32>, Error> {
    let parts = backlot_shaders::DENSITY_PARTS;
    let density = Parts::zeroed(upload.device, "density", node_count(levels), parts)?;
    let mut at = BRICK_NODES;
    for level in levels {
        for piece in level.density()[BRICK_NODES..].chunks(NODES_PER_COPY) {
            density.write(upload.device, at, piece);
            at += piece.len();
            upload.go_on()?;
        }
    }
    Ok(density)
}

/// Where bricks are found.
struct BrickIndex {
    levels: Vec<layout::Level>,
    brick_index: Vec<u32>,
}

/// Puts the levels one after the other; every level's null brick becomes brick 0.
fn index(levels: &[Lattice]) -> BrickIndex {
    let mut pyramid = BrickIndex {
        levels: Vec::new(),
        brick_index: Vec::new(),
    };
    let mut shift = 0;
    for level in levels {
        pyramid.levels.push(layout::Level {
            origin_m: level.origin_m().to_array(),
            voxel_m: level.voxel_m(),
            bricks: level.bricks_per_axis().to_array(),
            index_start: pyramid.brick_index.len() as u32,
        });
        let shifted = |&brick: &u32| {
            if brick == NULL_BRICK {
                NULL_BRICK
            } else {
                brick + shift
            }
        };
        pyramid
            .brick_index
            .extend(level.index().iter().map(shifted));
        // The next level's brick 1 comes after what is there already.
        shift += (level.density().len() / BRICK_NODES) as u32 - 1;
    }
    pyramid
}

fn blocks(occupancy: &Occupancy) -> Vec<layout::Block> {
    let stored = occupancy.masks().iter().zip(occupancy.steps_m());
    let block = |(words, step_m): (&[u64; 8], &f32)| {
        let mut mask = [0; 16];
        for (halves, word) in mask.chunks_exact_mut(2).zip(words) {
            halves.copy_from_slice(&[*word as u32, (*word >> 32) as u32]);
        }
        layout::Block {
            mask,
            step_m: *step_m,
        }
    };
    stored.map(block).collect()
}

fn params(field: &Field) -> layout::MarchParams {
    let (low, high) = field.bounds();
    let (occupancy, activation) = (field.occupancy(), field.activation());
    layout::MarchParams {
        low_m: low.to_array(),
        high_m: high.to_array(),
        base_voxel_m: activation.base_voxel_m,
        act_shift: activation.act_shift,
        occupancy_origin_m: occupancy.origin_m().to_array(),
        cell_m: occupancy.cell_m(),
        blocks: occupancy.blocks_per_axis().to_array(),
        level_count: field.levels().len() as u32,
        step_growth: field.step_growth,
        sigma_min: SIGMA_MIN,
        nudge_m: FACE_NUDGE * occupancy.cell_m(),
        ..Default::default()
    }
}
