//! Recomputes the occupancy mask from the field's density.

use glam::{UVec3, Vec3};
use rayon::prelude::*;

use crate::field::occupancy::BLOCK_SIDE;
use crate::field::{Field, Occupancy};

/// Cells on each side of an occupied one that are kept, so that surfaces can grow and their fronts keep a gradient.
const SIDE: usize = BLOCK_SIDE as usize;
type Mask = [u64; SIDE];

/// Surveys the blocks of 8^3 cells: `occupied(cell centre, finest voxel stored in its block)` says which cells can hold density.
///
/// Only blocks where some level stores a brick are asked about; the mask is dilated by one cell within stored space.
///
/// Rays will step by `step_voxels` of the finest voxel stored in a block.
pub(super) fn survey(
    field: &Field,
    step_voxels: f32,
    occupied: impl Fn(Vec3, f32) -> bool + Sync,
) -> Occupancy {
    let old = &field.occupancy;
    let (low, high) = field.bounds_m;
    let mut new = Occupancy::new(old.cell_m(), low, high - low).expect("same box as before");
    let blocks = new.blocks_per_axis();
    let numbers = 0..blocks.element_product();
    let masks: Vec<(UVec3, Mask, f32)> = numbers
        .into_par_iter()
        .with_min_len(64)
        .filter_map(|number| {
            let block = UVec3::new(
                number % blocks.x,
                number / blocks.x % blocks.y,
                number / (blocks.x * blocks.y),
            );
            let voxel_m = finest_voxel_in(field, &new, block)?;
            let mask = mask_of(&new, block, |centre| occupied(centre, voxel_m));
            (mask != [0; SIDE]).then_some((block, mask, step_voxels * voxel_m))
        })
        .collect();
    for (block, mask, step_m) in masks {
        new.set_block(block, mask, step_m);
    }
    new
}

/// Whether some point of the cell around `centre` has an opacity above `alpha` over one finest voxel.
///
/// Where voxels are no finer than cells, density hardly changes within a cell and its centre speaks for it.
pub(super) fn is_dense(field: &Field, centre: Vec3, voxel_m: f32, alpha: f32) -> bool {
    let threshold = -(-alpha).ln_1p() / field.activation.base_voxel_m;
    // Compared before the activation, which costs more than the look-up.
    let raw = field.activation.raw(threshold);
    if voxel_m >= field.occupancy.cell_m() {
        return field.raw_density(centre) > raw;
    }
    let quarter = field.occupancy.cell_m() / 4.0;
    (0..8).any(|corner| {
        let sign = |bit: i32| {
            if corner >> bit & 1 == 0 {
                -quarter
            } else {
                quarter
            }
        };
        field.raw_density(centre + Vec3::new(sign(0), sign(1), sign(2))) > raw
    })
}

/// Grows the mask by one cell along each axis (26 neighbours in sum), within blocks that store something.
pub(super) fn dilate(field: &Field, step_voxels: f32, mask: &Occupancy) -> Occupancy {
    let mut grown = mask.clone();
    let blocks = mask.blocks_per_axis();
    let row = |x: i64, y: i64, z: i64| -> u64 {
        // 8 x bits of one cell row, bit 0 first; outside is empty.
        let size = blocks.as_i64vec3() * SIDE as i64;
        if y < 0 || z < 0 || x < 0 || y >= size.y || z >= size.z || x >= size.x {
            return 0;
        }
        let block = (z / 8 * blocks.y as i64 + y / 8) * blocks.x as i64 + x / 8;
        let stored = mask.index()[block as usize] as usize;
        mask.masks()[stored][(z & 7) as usize] >> ((y & 7) * 8) & 0xff
    };
    for number in 0..blocks.element_product() {
        let block = UVec3::new(
            number % blocks.x,
            number / blocks.x % blocks.y,
            number / (blocks.x * blocks.y),
        );
        let Some(voxel_m) = finest_voxel_in(field, mask, block) else {
            continue;
        };
        let first = block.as_i64vec3() * SIDE as i64;
        let mut out = [0u64; SIDE];
        for (z, word) in out.iter_mut().enumerate() {
            for y in 0..SIDE as i64 {
                let mut bits = 0;
                for (dz, dy) in [(0, 0), (-1, 0), (1, 0), (0, -1), (0, 1)] {
                    let (y, z) = (first.y + y + dy, first.z + z as i64 + dz);
                    let middle = row(first.x, y, z);
                    let left = row(first.x - 8, y, z) >> 7;
                    let right = row(first.x + 8, y, z) << 7 & 0xff;
                    bits |= middle | (middle << 1 & 0xff) | middle >> 1 | left | right;
                }
                *word |= bits << (y * 8);
            }
        }
        grown.set_block(block, out, step_voxels * voxel_m);
    }
    grown
}

/// The finest voxel stored anywhere in the block; `None` if nothing is.
fn finest_voxel_in(field: &Field, mask: &Occupancy, block: UVec3) -> Option<f32> {
    let side_m = mask.cell_m() * SIDE as f32;
    let low = mask.origin_m() + block.as_vec3() * side_m;
    for level in field.levels.iter().rev() {
        let brick_m = level.brick_m();
        let first = ((low - level.origin_m()) / brick_m + 1e-3)
            .floor()
            .max(Vec3::ZERO);
        let last = ((low + side_m - level.origin_m()) / brick_m - 1e-3)
            .floor()
            .max(Vec3::ZERO);
        let (first, last) = (first.as_uvec3(), last.as_uvec3());
        for z in first.z..=last.z {
            for y in first.y..=last.y {
                for x in first.x..=last.x {
                    if level.brick([x as u16, y as u16, z as u16]) != 0 {
                        return Some(level.voxel_m());
                    }
                }
            }
        }
    }
    None
}

fn mask_of(mask: &Occupancy, block: UVec3, occupied: impl Fn(Vec3) -> bool) -> Mask {
    let first = (block * BLOCK_SIDE).as_vec3() + 0.5;
    let mut words = [0; SIDE];
    for (z, word) in words.iter_mut().enumerate() {
        for bit in 0..64 {
            let cell = first + Vec3::new((bit & 7) as f32, (bit >> 3) as f32, z as f32);
            if occupied(mask.origin_m() + cell * mask.cell_m()) {
                *word |= 1 << bit;
            }
        }
    }
    words
}
