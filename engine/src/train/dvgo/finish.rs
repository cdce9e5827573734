//! The trained grid as an ordinary field.

use glam::{DVec3, UVec3, Vec3};

use super::stage::Stage;
use crate::field::lattice::FEATURES;
use crate::field::{BRICK_NODES, BRICK_SIDE, Field, Lattice, Occupancy};

/// A field of one level, every brick of it stored, which samples as the stage did. Its nodes must be cubes apart ([`cubic_box`]).
///
/// A cell is occupied where one of its corners is dense enough to be sampled, as interpolation exceeds no corner, and the mask
/// lets one of them be sampled.
pub(super) fn field_of(stage: &Stage<FEATURES>) -> Field {
    let shape = &stage.shape;
    let (low, high) = (shape.low.as_vec3(), shape.high.as_vec3());
    let voxel_m = shape.spacing_m().x as f32;
    let mlp = stage.mlp.clone().expect("the fine stage has one");
    Field {
        bounds_m: (low, high),
        levels: vec![level_of(stage, voxel_m, low)],
        activation: stage.activation,
        mlp,
        sky: None,
        occupancy: occupancy_of(stage, voxel_m, low),
        step_growth: 0.0,
    }
}

fn level_of(stage: &Stage<FEATURES>, voxel_m: f32, low: Vec3) -> Lattice {
    let shape = &stage.shape;
    let mut level =
        Lattice::with_bricks(voxel_m, low, shape.bricks).expect("the grid is of a sound size");
    level.reserve(shape.brick_count());
    for brick in 0..shape.brick_count() {
        level.allocate(shape.brick_position(brick).to_array().map(|c| c as u16));
    }
    // Bricks are stored in the grid's order, behind the null brick.
    let (density, features) = level.parameters_mut();
    density[BRICK_NODES..].copy_from_slice(&stage.density);
    features[BRICK_NODES..].copy_from_slice(&stage.colors);
    level
}

fn occupancy_of(stage: &Stage<FEATURES>, voxel_m: f32, low: Vec3) -> Occupancy {
    let (shape, medium) = (&stage.shape, stage.medium());
    let mut occupancy =
        Occupancy::with_blocks(voxel_m, low, shape.bricks).expect("the grid is of a sound size");
    let masked = |node: UVec3| medium.mask.near(node.as_vec3());
    let dense = |node: UVec3| medium.density[shape.at(node)] > medium.raw_min;
    for brick in 0..shape.brick_count() {
        let block = shape.brick_position(brick);
        let mut bits = [0u64; BRICK_SIDE];
        for local in 0..BRICK_NODES as u32 {
            let cell = block * 8 + UVec3::new(local & 7, local >> 3 & 7, local >> 6);
            let last = shape.nodes - 1;
            let corners =
                [0, 1, 2, 3, 4, 5, 6, 7].map(|c| cell + UVec3::new(c & 1, c >> 1 & 1, c >> 2));
            let sampled = |corners: [UVec3; 8]| {
                corners.into_iter().any(dense) && corners.into_iter().any(masked)
            };
            if cell.cmplt(last).all() && sampled(corners) {
                bits[(local >> 6) as usize] |= 1 << (local & 63);
            }
        }
        occupancy.set_block(block, bits, stage.step_m() as f32);
    }
    occupancy
}

/// The box grown about its centre until `nodes` divide it into cubes: by less than a voxel per axis.
pub(super) fn cubic_box((low, high): (DVec3, DVec3), nodes: UVec3) -> (DVec3, DVec3) {
    let spans = (nodes - 1).as_dvec3();
    let spacing_m = ((high - low) / spans).max_element();
    let (centre, half) = ((low + high) / 2.0, spans * spacing_m / 2.0);
    (centre - half, centre + half)
}
