//! Which nodes can colour a pixel.

use glam::{IVec3, UVec3, Vec3};
use rayon::prelude::*;

use crate::field::occupancy::BLOCK_SIDE;
use crate::field::{BRICK_SIDE, Field, Lattice, NULL_BRICK};

const SIDE: usize = BLOCK_SIDE as usize;

/// Opacity over one step below which a cell's colour is not stored: renderers leave samples of this weight uncoloured, and
/// training taught them nothing.
const VISIBLE_ALPHA: f32 = 1e-3;

/// Bits of a brick's nodes: word z, bit `y * 8 + x`.
pub(super) type NodeBits = [u64; BRICK_SIDE];

/// A block of occupancy cells with the visible ones marked: word z, bit `y * 8 + x`.
struct VisibleBlock {
    low_m: Vec3,
    cells: [u64; SIDE],
    step_m: f32,
}

/// The cells of a field that are visible where a ray samples them.
pub(super) struct VisibleCells {
    cell_m: f32,
    blocks: Vec<VisibleBlock>,
}

impl VisibleCells {
    pub(super) fn of(field: &Field) -> Self {
        let mask = &field.occupancy;
        let cell_m = mask.cell_m();
        let extent = mask.blocks_per_axis();
        let stored = mask.index().par_iter().enumerate();
        let blocks = stored.filter(|(_, stored)| **stored != 0);
        let blocks = blocks.map(|(at, stored)| {
            let at = at as u32;
            let block = UVec3::new(
                at % extent.x,
                at / extent.x % extent.y,
                at / (extent.x * extent.y),
            );
            let low_m = mask.origin_m() + block.as_vec3() * cell_m * SIDE as f32;
            let step_m = mask.steps_m()[*stored as usize];
            let mut cells = mask.masks()[*stored as usize];
            let threshold = field.activation.raw(-(-VISIBLE_ALPHA).ln_1p() / step_m);
            keep_cells(&mut cells, |cell| {
                let low = low_m + cell.as_vec3() * cell_m;
                probes(low, cell_m).any(|p| field.raw_density(p) > threshold)
            });
            VisibleBlock {
                low_m,
                cells,
                step_m,
            }
        });
        let blocks = blocks.filter(|block| block.cells != [0; SIDE]).collect();
        Self { cell_m, blocks }
    }

    /// The nodes of every stored brick of a level that samples in visible cells interpolate.
    pub(super) fn nodes(&self, level: &Lattice) -> Vec<NodeBits> {
        let mut nodes = vec![[0; BRICK_SIDE]; level.brick_count()];
        for block in &self.blocks {
            // A step that begins in a cell is sampled in its middle, which may lie beyond the cell.
            let margin_m = Vec3::splat(block.step_m / 2.0);
            for_each_cell(&block.cells, |cell| {
                let low = block.low_m + cell.as_vec3() * self.cell_m;
                let high = low + self.cell_m;
                mark(level, low - margin_m, high + margin_m, &mut nodes);
            });
        }
        nodes
    }
}

/// The corners of a cell's middle half and its centre: where voxels are half a cell, density hardly varies between them.
fn probes(low: Vec3, cell_m: f32) -> impl Iterator<Item = Vec3> {
    let corner = move |n: u32| {
        let bit = |b: u32| 0.25 + 0.5 * (n >> b & 1) as f32;
        low + Vec3::new(bit(0), bit(1), bit(2)) * cell_m
    };
    (0..8)
        .map(corner)
        .chain(std::iter::once(low + 0.5 * cell_m))
}

fn keep_cells(cells: &mut [u64; SIDE], keep: impl Fn(UVec3) -> bool) {
    let before = *cells;
    for_each_cell(&before, |cell| {
        if !keep(cell) {
            cells[cell.z as usize] &= !(1 << (cell.y * BLOCK_SIDE + cell.x));
        }
    });
}

fn for_each_cell(cells: &[u64; SIDE], mut visit: impl FnMut(UVec3)) {
    for (z, word) in cells.iter().enumerate() {
        let mut word = *word;
        while word != 0 {
            let bit = word.trailing_zeros();
            word &= word - 1;
            visit(UVec3::new(bit % BLOCK_SIDE, bit / BLOCK_SIDE, z as u32));
        }
    }
}

/// Marks the nodes that positions between `low` and `high` interpolate.
fn mark(level: &Lattice, low: Vec3, high: Vec3, nodes: &mut [NodeBits]) {
    let per_m = level.voxel_m().recip();
    let most = (level.bricks_per_axis() * BRICK_SIDE as u32).as_ivec3() - 1;
    let at = |p: Vec3| ((p - level.origin_m()) * per_m).floor().as_ivec3();
    let first = at(low).clamp(IVec3::ZERO, most).as_uvec3();
    let last = (at(high) + 1).clamp(IVec3::ZERO, most).as_uvec3();
    for z in first.z..=last.z {
        for y in first.y..=last.y {
            for x in first.x..=last.x {
                let brick = level.brick([x >> 3, y >> 3, z >> 3].map(|c| c as u16));
                if brick != NULL_BRICK {
                    nodes[brick as usize][(z & 7) as usize] |= 1 << ((y & 7) * 8 + (x & 7));
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::field::{BRICK_NODES, ColorMlp, DensityActivation, Occupancy};

    /// A wall of one voxel's thickness in a level of 0.1 m, all of whose cells are occupied.
    fn wall() -> Field {
        let size = Vec3::splat(3.2);
        let mut level = Lattice::new(0.1, Vec3::ZERO, size).unwrap();
        level.allocate_all();
        let positions = level.positions().to_vec();
        let (density, _) = level.parameters_mut();
        for (brick, at) in positions.iter().enumerate().skip(1) {
            for node in 0..BRICK_NODES {
                let x = usize::from(at[0]) * BRICK_SIDE + node % BRICK_SIDE;
                density[brick * BRICK_NODES + node] = if x == 17 { 12.0 } else { -6.0 };
            }
        }
        let mut occupancy = Occupancy::new(0.2, Vec3::ZERO, size).unwrap();
        for block in 0..8 {
            let at = UVec3::new(block & 1, block >> 1 & 1, block >> 2);
            occupancy.set_block(at, [u64::MAX; SIDE], 0.1);
        }
        let mut draws = 0.0;
        Field {
            bounds_m: (Vec3::ZERO, size),
            levels: vec![level],
            activation: DensityActivation::from_alpha(1e-3, 0.1),
            mlp: ColorMlp::new(16, || {
                draws = (draws + 0.37) % 1.0;
                draws
            }),
            sky: None,
            occupancy,
            step_growth: 0.0,
        }
    }

    #[test]
    fn only_nodes_around_the_wall_are_visible_and_all_of_those() {
        let field = wall();
        let level = &field.levels[0];
        let nodes = VisibleCells::of(&field).nodes(level);
        let seen = |x: usize| {
            let brick = level.brick([(x / 8) as u16, 2, 1]);
            nodes[brick as usize][3] >> (4 * 8 + x % 8) & 1 == 1
        };
        let columns: Vec<usize> = (0..32).filter(|x| seen(*x)).collect();
        // Density reaches one voxel from the wall's nodes; those samples interpolate nodes 16 to 18, and no sample of weight
        // interpolates what is more than a cell and a step away.
        assert!(columns.contains(&16) && columns.contains(&17) && columns.contains(&18));
        assert!(columns.iter().all(|x| (13..=21).contains(x)), "{columns:?}");
    }
}
