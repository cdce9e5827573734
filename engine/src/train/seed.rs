//! Bricks and density around LiDAR returns, before the first step.

use std::collections::BTreeSet;

use glam::{UVec3, Vec3};

use super::refine::{Urgency, allocate_urgent};
use crate::field::Field;

/// Edge of an occupancy cell in finest voxels.
pub(super) const CELL_VOXELS: f32 = 2.0;
/// Returns put density on nodes that share at least this much of them.
const SEED_WEIGHT: f32 = 0.1;
/// Seeds go to the finest level whose voxels are at least this coarse, in metres: finer ones would leave gaps between returns.
const SEED_VOXEL_M: f32 = 0.2;

/// A set of occupancy cells.
#[derive(Debug)]
pub(super) struct CellSet {
    cell_m: f32,
    origin_m: Vec3,
    cells: UVec3,
    bits: Vec<u64>,
}

impl CellSet {
    fn empty(field: &Field) -> Self {
        let mask = field.occupancy();
        let cells = mask.blocks_per_axis() * crate::field::occupancy::BLOCK_SIDE;
        let count = cells.as_u64vec3().element_product() as usize;
        Self {
            cell_m: mask.cell_m(),
            origin_m: mask.origin_m(),
            cells,
            bits: vec![0; count.div_ceil(64)],
        }
    }

    /// The cells within two cells of a point.
    pub(super) fn around_points(field: &Field, points: &[Vec3]) -> Self {
        let mut set = Self::empty(field);
        for p in points {
            let reach = Vec3::splat(2.0 * set.cell_m);
            set.insert_box(*p - reach, *p + reach);
        }
        set
    }

    /// The cells that touch cubes of edge `side_m`, given by their lower corners.
    pub(super) fn of_cubes(field: &Field, corners: &[Vec3], side_m: f32) -> Self {
        let mut set = Self::empty(field);
        for corner in corners {
            set.insert_box(*corner, *corner + side_m);
        }
        set
    }

    pub(super) fn contains(&self, p: Vec3) -> bool {
        let q = ((p - self.origin_m) / self.cell_m).floor();
        if !(q.cmpge(Vec3::ZERO).all() && q.cmplt(self.cells.as_vec3()).all()) {
            return false;
        }
        let at = self.number(q.as_uvec3());
        self.bits[at / 64] >> (at % 64) & 1 != 0
    }

    fn insert_box(&mut self, low: Vec3, high: Vec3) {
        let first = ((low - self.origin_m) / self.cell_m)
            .max(Vec3::ZERO)
            .as_uvec3();
        let last = ((high - self.origin_m) / self.cell_m)
            .max(Vec3::ZERO)
            .as_uvec3();
        let last = last.min(self.cells - 1);
        for z in first.z..=last.z {
            for y in first.y..=last.y {
                for x in first.x..=last.x {
                    let at = self.number(UVec3::new(x, y, z));
                    self.bits[at / 64] |= 1 << (at % 64);
                }
            }
        }
    }

    fn number(&self, cell: UVec3) -> usize {
        let row = self.cells.x as usize;
        (cell.z as usize * self.cells.y as usize + cell.y as usize) * row + cell.x as usize
    }
}

/// Stores the bricks that interpolate around every point, coarse to fine and by their `urgency` within the bound.
pub(super) fn store_around_points(
    field: &mut Field,
    points: &[Vec3],
    memory_bytes: u64,
    urgency: Urgency<'_>,
) {
    for number in 0..field.levels.len() {
        let level = &field.levels[number];
        let mut wanted = BTreeSet::new();
        for p in points {
            for corner in 0..8 {
                let sign = |bit: i32| if corner >> bit & 1 == 0 { -1.0 } else { 1.0 };
                let p = *p + Vec3::new(sign(0), sign(1), sign(2)) * level.voxel_m() * 1.5;
                if let Some(at) = level.brick_at(p) {
                    wanted.insert(at);
                }
            }
        }
        allocate_urgent(field, number, wanted.into_iter(), memory_bytes, urgency);
    }
}

/// Raises density around every point, so that training starts from roughly the right surfaces.
pub(super) fn seed_density(field: &mut Field, points: &[Vec3], sigma: f32) {
    let raw = field.activation.raw(sigma);
    let seeded = field
        .levels
        .iter()
        .rposition(|level| level.voxel_m() >= SEED_VOXEL_M);
    let level = &mut field.levels[seeded.unwrap_or(0)];
    for p in points {
        let Some(corners) = level.corners(*p) else {
            continue;
        };
        let (density, _) = level.parameters_mut();
        for (node, weight) in corners.nodes.into_iter().zip(corners.weights) {
            let stored = node as usize >= crate::field::BRICK_NODES;
            if stored && weight > SEED_WEIGHT {
                density[node as usize] = raw;
            }
        }
    }
}
