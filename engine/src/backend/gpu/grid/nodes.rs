//! A dense grid's values with their gradients and optimiser state in device buffers.

use backlot_shaders::grid_layout;
use bytemuck::{AnyBitPattern, NoUninit};
use wgpu::BufferUsages;

use crate::backend::gpu::buffer::Buffer;
use crate::backend::gpu::device::Device;
use crate::backend::gpu::error::Error;
use crate::backend::gpu::transfer::{NODES_PER_COPY, Transfer};
use crate::train::dvgo::{NodeMask, Stage};

pub(super) type Quad = [f32; 4];

/// Values, gradients and moments by node, in the stage's order, and what is known of its bricks.
#[derive(Debug)]
pub(super) struct Nodes {
    pub(super) mask: Buffer<grid_layout::MaskBlock>,
    pub(super) density: ValueNodes<f32>,
    /// Factors on the density's rate, if there are any.
    pub(super) shares: Buffer<f32>,
    pub(super) has_shares: bool,
    /// One of direct colour, or three of features.
    pub(super) quads: Vec<ValueNodes<Quad>>,
    /// In the place of quads that a stage does not have.
    pub(super) nothing: [Buffer<Quad>; 2],
    /// Step of each brick's last gradient, and of its last move.
    pub(super) brick_seen: Buffer<u32>,
    pub(super) brick_moved: Buffer<u32>,
    /// What a step does with it.
    pub(super) brick_turns: Buffer<u32>,
}

/// A node's density, or four of its colour values.
#[derive(Debug)]
pub(super) struct ValueNodes<T> {
    pub(super) values: Buffer<T>,
    pub(super) gradients: Buffer<T>,
    /// Running means of the gradients and of their squares: apart, so that a binding holds as many nodes of each.
    pub(super) means: Buffer<T>,
    pub(super) squares: Buffer<T>,
}

const VALUES: [&str; 3] = [
    "colour values 0 to 3",
    "colour values 4 to 7",
    "colour values 8 to 11",
];

impl<T: NoUninit + AnyBitPattern> ValueNodes<T> {
    fn new(device: &Device, what: &'static str, nodes: usize) -> Result<Self, Error> {
        let zeroed = |what| Buffer::zeroed(device, what, nodes, BufferUsages::STORAGE);
        Ok(Self {
            values: zeroed(what)?,
            gradients: zeroed("gradients of a grid")?,
            means: zeroed("mean gradients of a grid")?,
            squares: zeroed("mean squared gradients of a grid")?,
        })
    }
}

impl Nodes {
    pub(super) fn upload<const C: usize>(
        upload: Transfer<'_>,
        stage: &Stage<C>,
    ) -> Result<Self, Error> {
        let device = upload.device;
        let (nodes, bricks) = (stage.shape.len(), stage.shape.brick_count());
        let storage = BufferUsages::STORAGE;
        let per_brick = |what| Buffer::zeroed(device, what, bricks, storage);
        let nothing = || Buffer::zeroed(device, "no quad", 1, storage);
        let shares = stage.density_shares.len().max(1);
        let quads = (0..C / 4).map(|number| ValueNodes::new(device, VALUES[number], nodes));
        let grid = Self {
            mask: Buffer::zeroed(device, "mask", bricks, storage)?,
            density: ValueNodes::new(device, "densities of a grid", nodes)?,
            shares: Buffer::zeroed(device, "density shares", shares, storage)?,
            has_shares: !stage.density_shares.is_empty(),
            quads: quads.collect::<Result<_, _>>()?,
            nothing: [nothing()?, nothing()?],
            brick_seen: per_brick("brick gradients")?,
            brick_moved: per_brick("brick moves")?,
            brick_turns: per_brick("brick turns")?,
        };
        grid.write_mask(device, &stage.mask);
        write(upload, &grid.density.values, &stage.density)?;
        write(upload, &grid.shares, &stage.density_shares)?;
        let mut quads = Vec::with_capacity(NODES_PER_COPY);
        for (number, quad) in grid.quads.iter().enumerate() {
            let pieces = stage.colors.chunks(NODES_PER_COPY);
            for (piece, colors) in pieces.enumerate() {
                quads.clear();
                quads.extend(colors.iter().map(|node| node.as_chunks::<4>().0[number]));
                quad.values.write_at(device, piece * NODES_PER_COPY, &quads);
                upload.go_on()?;
            }
        }
        Ok(grid)
    }

    pub(super) fn write_mask(&self, device: &Device, mask: &NodeMask) {
        let blocks: Vec<grid_layout::MaskBlock> = mask
            .blocks()
            .map(|bits| grid_layout::MaskBlock {
                bits,
                any: u32::from(bits != [0; 16]),
            })
            .collect();
        self.mask.write(device, &blocks);
    }

    pub(super) fn fetch_density(&self, pieces: Transfer<'_>, out: &mut [f32]) -> Result<(), Error> {
        for (piece, out) in out.chunks_mut(NODES_PER_COPY).enumerate() {
            let read =
                self.density
                    .values
                    .read_at(pieces.device, piece * NODES_PER_COPY, out.len())?;
            out.copy_from_slice(&read);
            pieces.go_on()?;
        }
        Ok(())
    }

    pub(super) fn fetch_colors<const C: usize>(
        &self,
        pieces: Transfer<'_>,
        out: &mut [[f32; C]],
    ) -> Result<(), Error> {
        for (number, quad) in self.quads.iter().enumerate() {
            for (piece, out) in out.chunks_mut(NODES_PER_COPY).enumerate() {
                let first = piece * NODES_PER_COPY;
                let read = quad.values.read_at(pieces.device, first, out.len())?;
                for (node, quad) in out.iter_mut().zip(&read) {
                    node.as_chunks_mut::<4>().0[number] = *quad;
                }
                pieces.go_on()?;
            }
        }
        Ok(())
    }
}

fn write(upload: Transfer<'_>, buffer: &Buffer<f32>, values: &[f32]) -> Result<(), Error> {
    for (piece, values) in values.chunks(NODES_PER_COPY).enumerate() {
        buffer.write_at(upload.device, piece * NODES_PER_COPY, values);
        upload.go_on()?;
    }
    Ok(())
}
