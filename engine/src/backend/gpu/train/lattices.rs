//! A field's nodes with their gradients and optimiser state in device buffers.

use backlot_shaders::layout;
use wgpu::BufferUsages;

use crate::backend::gpu::buffer::Buffer;
use crate::backend::gpu::device::Device;
use crate::backend::gpu::error::Error;
use crate::backend::gpu::field::{blocks, flatten, params};
use crate::field::{BRICK_NODES, FEATURES, Field, Lattice};

type Quad = [f32; 4];

/// Mean squared gradients of one level's nodes, kept on the host while its bricks change.
#[derive(Clone, Debug, Default)]
pub(super) struct LevelSquares {
    density: Vec<f32>,
    features: Vec<f32>,
}

impl LevelSquares {
    fn resize(&mut self, nodes: usize) {
        self.density.resize(nodes, 0.0);
        self.features.resize(nodes, 0.0);
    }

    /// Follows [`Lattice::retain`].
    pub(super) fn retain(&mut self, old_of_new: &[u32]) {
        for squares in [&mut self.density, &mut self.features] {
            for (new, old) in old_of_new.iter().enumerate() {
                let from = *old as usize * BRICK_NODES;
                squares.copy_within(from..from + BRICK_NODES, new * BRICK_NODES);
            }
            squares.truncate(old_of_new.len() * BRICK_NODES);
        }
    }
}

/// All levels under one brick numbering, whose brick 0 is the null brick of each. Features are three quads, each in a buffer of its
/// own, so that none outgrows a binding.
#[derive(Debug)]
pub(super) struct Lattices {
    pub(super) levels: Buffer<layout::Level>,
    pub(super) brick_index: Buffer<u32>,
    pub(super) block_index: Buffer<u32>,
    pub(super) blocks: Buffer<layout::Block>,
    pub(super) density: Buffer<f32>,
    pub(super) features: [Buffer<Quad>; 3],
    pub(super) density_gradients: Buffer<f32>,
    pub(super) feature_gradients: [Buffer<Quad>; 3],
    pub(super) density_squares: Buffer<f32>,
    pub(super) feature_squares: Buffer<f32>,
    /// 1 for bricks in the list of `touched_bricks`, which starts with their number.
    pub(super) brick_marks: Buffer<u32>,
    pub(super) touched_bricks: Buffer<u32>,
    pub(super) brick_places: Buffer<layout::BrickPlace>,
    /// The field's constants; the dispatch's fields are zero.
    pub(super) params: layout::MarchParams,
}

impl Lattices {
    pub(super) fn upload(
        device: &Device,
        field: &Field,
        squares: &mut [LevelSquares],
    ) -> Result<Self, Error> {
        let pyramid = flatten(field.levels());
        let nodes = pyramid.density.len();
        let bricks = nodes / BRICK_NODES;
        let mut joined = LevelSquares::default();
        joined.resize(BRICK_NODES);
        for (level, squares) in field.levels().iter().zip(squares) {
            squares.resize(level.density().len());
            joined.density.extend(&squares.density[BRICK_NODES..]);
            joined.features.extend(&squares.features[BRICK_NODES..]);
        }
        let storage = BufferUsages::STORAGE;
        let quads = |quad: usize| {
            let values = joined_quads(field.levels(), quad);
            Buffer::from_slice(device, FEATURE_LABELS[quad], &values, storage)
        };
        let quad_gradients = |label| Buffer::zeroed(device, label, nodes, storage);
        let occupancy = field.occupancy();
        Ok(Self {
            levels: Buffer::from_slice(device, "levels", &pyramid.levels, storage)?,
            brick_index: Buffer::from_slice(device, "brick index", &pyramid.brick_index, storage)?,
            block_index: Buffer::from_slice(device, "occupancy index", occupancy.index(), storage)?,
            blocks: Buffer::from_slice(device, "occupancy blocks", &blocks(occupancy), storage)?,
            density: Buffer::from_slice(device, "density", &pyramid.density, storage)?,
            features: [quads(0)?, quads(1)?, quads(2)?],
            density_gradients: Buffer::zeroed(device, "density gradients", nodes, storage)?,
            feature_gradients: [
                quad_gradients("gradients of features 0 to 3")?,
                quad_gradients("gradients of features 4 to 7")?,
                quad_gradients("gradients of features 8 to 11")?,
            ],
            density_squares: Buffer::from_slice(
                device,
                "density squares",
                &joined.density,
                storage,
            )?,
            feature_squares: Buffer::from_slice(
                device,
                "feature squares",
                &joined.features,
                storage,
            )?,
            brick_marks: Buffer::zeroed(device, "brick marks", bricks, storage)?,
            touched_bricks: Buffer::zeroed(device, "touched bricks", bricks + 1, storage)?,
            brick_places: Buffer::from_slice(
                device,
                "brick places",
                &brick_places(field.levels()),
                storage,
            )?,
            params: params(field),
        })
    }

    /// Copies parameters and optimiser state back to the host, whose bricks must be those that were uploaded.
    pub(super) fn fetch(
        &self,
        device: &Device,
        field: &mut Field,
        squares: &mut [LevelSquares],
    ) -> Result<(), Error> {
        let nodes = self.density.len();
        let density = self.density.read(device, nodes)?;
        let density_squares = self.density_squares.read(device, nodes)?;
        let feature_squares = self.feature_squares.read(device, nodes)?;
        let mut quads = Vec::new();
        for quad in &self.features {
            quads.push(quad.read(device, nodes)?);
        }
        let mut start = BRICK_NODES;
        for (level, squares) in field.levels.iter_mut().zip(squares) {
            let (own_density, own_features) = level.parameters_mut();
            let own = own_density.len() - BRICK_NODES;
            let from = start..start + own;
            start += own;
            own_density[BRICK_NODES..].copy_from_slice(&density[from.clone()]);
            for (node, features) in from.clone().zip(&mut own_features[BRICK_NODES..]) {
                for (quad, values) in features.as_chunks_mut::<4>().0.iter_mut().zip(&quads) {
                    *quad = values[node];
                }
            }
            squares.resize(own + BRICK_NODES);
            squares.density[BRICK_NODES..].copy_from_slice(&density_squares[from.clone()]);
            squares.features[BRICK_NODES..].copy_from_slice(&feature_squares[from]);
        }
        Ok(())
    }
}

const FEATURE_LABELS: [&str; 3] = ["features 0 to 3", "features 4 to 7", "features 8 to 11"];

/// One quad of the features of all levels, the null brick first.
fn joined_quads(levels: &[Lattice], quad: usize) -> Vec<Quad> {
    let mut values = vec![[0.0; 4]; BRICK_NODES];
    for level in levels {
        let own = level.features()[BRICK_NODES..].iter();
        values.extend(own.map(|features: &[f32; FEATURES]| features.as_chunks::<4>().0[quad]));
    }
    values
}

/// Where every brick lies, the null brick first.
fn brick_places(levels: &[Lattice]) -> Vec<layout::BrickPlace> {
    let mut places = vec![layout::BrickPlace::default()];
    for (level, lattice) in (0..).zip(levels) {
        places.extend(
            lattice.positions()[1..]
                .iter()
                .map(|position| layout::BrickPlace {
                    position: position.map(u32::from),
                    level,
                }),
        );
    }
    places
}
