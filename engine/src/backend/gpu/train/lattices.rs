//! A field's nodes with their gradients and optimiser state in device buffers.

use backlot_shaders::layout;
use wgpu::BufferUsages;

use super::squares::LevelSquares;
use crate::backend::gpu::buffer::Buffer;
use crate::backend::gpu::error::Error;
use crate::backend::gpu::features::{self, QUADS, Quad};
use crate::backend::gpu::field::ResidentField;
use crate::backend::gpu::parts::Parts;
use crate::backend::gpu::transfer::{NODES_PER_COPY, Transfer};
use crate::field::{BRICK_NODES, Field, Lattice};

/// All levels under one brick numbering, whose brick 0 is the null brick of each. What no binding holds as a whole is divided into parts,
/// all but the densities alike; kernels take one part after the other.
#[derive(Debug)]
pub(super) struct Lattices {
    pub(super) shape: ResidentField,
    pub(super) features: [Parts<Quad>; QUADS],
    pub(super) density_gradients: Parts<f32>,
    pub(super) feature_gradients: [Parts<Quad>; QUADS],
    pub(super) density_squares: Parts<f32>,
    pub(super) feature_squares: Parts<f32>,
    /// 1 for bricks in the list of `touched_bricks`, which starts with their number.
    pub(super) brick_marks: Buffer<u32>,
    pub(super) touched_bricks: Buffer<u32>,
    pub(super) brick_places: Buffer<layout::BrickPlace>,
    /// One a part.
    pub(super) parts: Vec<Buffer<layout::PartParams>>,
}

impl Lattices {
    pub(super) fn upload(
        upload: Transfer<'_>,
        field: &Field,
        squares: &mut [LevelSquares],
    ) -> Result<Self, Error> {
        let (device, levels) = (upload.device, field.levels());
        let features = features::upload(upload, levels)?;
        let (nodes, division) = (features[0].nodes(), features[0].nodes_per_part());
        let bricks = nodes / BRICK_NODES;
        let storage = BufferUsages::STORAGE;
        let scalars = |what| Parts::divided(device, what, nodes, division);
        let quads = |what| Parts::divided(device, what, nodes, division);
        let shape = ResidentField::upload(upload, field)?;
        let parts = part_params(&shape, &features[0]);
        let lattices = Self {
            shape,
            features,
            density_gradients: scalars("density gradients")?,
            feature_gradients: [
                quads("gradients of features 0 to 3")?,
                quads("gradients of features 4 to 7")?,
                quads("gradients of features 8 to 11")?,
            ],
            density_squares: scalars("density squares")?,
            feature_squares: scalars("feature squares")?,
            brick_marks: Buffer::zeroed(device, "brick marks", bricks, storage)?,
            touched_bricks: Buffer::zeroed(device, "touched bricks", bricks + 1, storage)?,
            brick_places: Buffer::from_slice(
                device,
                "brick places",
                &brick_places(levels),
                storage,
            )?,
            parts: parts
                .iter()
                .map(|part| Buffer::from_slice(device, "part", &[*part], BufferUsages::UNIFORM))
                .collect::<Result<_, _>>()?,
        };
        lattices.write_squares(upload, levels, squares)?;
        Ok(lattices)
    }

    /// Nodes of all levels and of the null brick.
    pub(super) fn nodes(&self) -> usize {
        self.features[0].nodes()
    }

    fn write_squares(
        &self,
        upload: Transfer<'_>,
        levels: &[Lattice],
        squares: &mut [LevelSquares],
    ) -> Result<(), Error> {
        let mut at = BRICK_NODES;
        for (level, squares) in levels.iter().zip(squares) {
            squares.resize(level.density().len());
            let density = squares.density[BRICK_NODES..].chunks(NODES_PER_COPY);
            let features = squares.features[BRICK_NODES..].chunks(NODES_PER_COPY);
            for (density, features) in density.zip(features) {
                self.density_squares.write(upload.device, at, density);
                self.feature_squares.write(upload.device, at, features);
                at += density.len();
                upload.go_on()?;
            }
        }
        Ok(())
    }

    /// Copies parameters and optimiser state back to the host, whose bricks must be those that were uploaded.
    pub(super) fn fetch(
        &self,
        pieces: Transfer<'_>,
        field: &mut Field,
        squares: &mut [LevelSquares],
    ) -> Result<(), Error> {
        let mut at = BRICK_NODES;
        for (level, squares) in field.levels.iter_mut().zip(squares) {
            let (density, features) = level.parameters_mut();
            squares.resize(density.len());
            for first in (BRICK_NODES..density.len()).step_by(NODES_PER_COPY) {
                let own = first..density.len().min(first + NODES_PER_COPY);
                let count = own.len();
                let read = |values: &Parts<f32>| values.read(pieces.device, at, count);
                density[own.clone()].copy_from_slice(&read(&self.shape.density)?);
                squares.density[own.clone()].copy_from_slice(&read(&self.density_squares)?);
                squares.features[own.clone()].copy_from_slice(&read(&self.feature_squares)?);
                for (number, quads) in self.features.iter().enumerate() {
                    let quads = quads.read(pieces.device, at, count)?;
                    for (node, quad) in features[own.clone()].iter_mut().zip(&quads) {
                        node.as_chunks_mut::<4>().0[number] = *quad;
                    }
                }
                at += count;
                pieces.go_on()?;
            }
        }
        Ok(())
    }
}

/// The parts that features are divided into, and where the densities of each are.
fn part_params(shape: &ResidentField, quads: &Parts<Quad>) -> Vec<layout::PartParams> {
    let mut first_node = 0;
    let mut params = Vec::new();
    for part in quads.parts() {
        let (_, first_density) = shape.density.holding(first_node);
        params.push(layout::PartParams {
            level_count: shape.params.level_count,
            first_node: first_node as u32,
            node_count: part.len() as u32,
            first_density: first_density as u32,
        });
        first_node += part.len();
    }
    params
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
