//! Prunes what stayed empty and stores finer bricks where something is.

use glam::{UVec3, Vec3};
use rayon::prelude::*;

use super::preset::TrainPreset;
use super::survey::{dilate, is_dense, survey};
use crate::Result;
use crate::backend::Trainer;
use crate::field::occupancy::{BLOCK_SIDE, Space};
use crate::field::{BRICK_NODES, FEATURES, Field, Lattice, NULL_BRICK, Occupancy};

/// Bytes per node: density and 12 features, and one second moment for each of the two.
pub(super) const NODE_BYTES: u64 = 4 * (1 + FEATURES as u64 + 2);

/// Bytes of one brick with its optimiser state.
pub(super) const BRICK_BYTES: u64 = BRICK_NODES as u64 * NODE_BYTES;

/// Whether a level stores a brick around a point, and in which order while memory is short: the lowest first, `None` never.
pub(super) type Urgency<'a> = &'a (dyn Fn(Vec3, usize) -> Option<f32> + Sync);

/// Surveys the field, drops bricks no occupied cell reads, and stores bricks at occupied cells by their `urgency`.
///
/// Returns a warning if the memory bound kept bricks from being stored.
///
/// # Errors
/// [`crate::Error::Cancelled`], or the device's.
pub(super) fn refine(
    trainer: &mut Trainer,
    preset: &TrainPreset,
    urgency: Urgency<'_>,
    cancelled: &dyn Fn() -> bool,
) -> Result<Option<String>> {
    trainer.fetch(cancelled)?;
    let field = trainer.field();
    let old = &field.occupancy;
    let dense = survey(field, preset.step_voxels, |centre, voxel_m| {
        let occupied = !matches!(old.at(centre), Space::Empty { .. });
        occupied && is_dense(field, centre, voxel_m, preset.survey_alpha)
    });
    let grown = dilate(field, preset.step_voxels, &dense);
    let levels = field.levels.par_iter();
    let read: Vec<Vec<bool>> = levels.map(|level| bricks_read(level, &grown)).collect();
    let mut full = false;
    for (number, read) in read.iter().enumerate() {
        let level = &trainer.field().levels[number];
        let positions = level.positions().to_vec();
        let bricks = level.bricks_per_axis();
        trainer.retain_bricks(number, |brick| {
            read[brick_number(bricks, positions[brick as usize])]
        });
    }
    for (number, read) in read.iter().enumerate() {
        full |= store_bricks(
            trainer.field_mut(),
            number,
            read,
            preset.memory_bytes,
            urgency,
        );
    }
    // Steps follow the finest stored voxel, which may have changed.
    let field = trainer.field();
    let stepped = survey(field, preset.step_voxels, |centre, _| {
        !matches!(grown.at(centre), Space::Empty { .. })
    });
    trainer.field_mut().occupancy = stepped;
    Ok(full.then(|| {
        format!(
            "the memory bound of {} MiB kept fine voxels from being stored everywhere",
            preset.memory_bytes >> 20
        )
    }))
}

/// Which brick positions hold nodes that occupied cells interpolate.
fn bricks_read(level: &Lattice, occupied: &Occupancy) -> Vec<bool> {
    let bricks = level.bricks_per_axis();
    let mut read = vec![false; bricks.as_u64vec3().element_product() as usize];
    for_each_cell(occupied, |low, side_m| {
        // A cell reads nodes up to one voxel beyond its corners; bricks own their first node only.
        let reach = side_m + level.voxel_m();
        for corner in 0..8 {
            let step = Vec3::new(
                (corner & 1) as f32,
                (corner >> 1 & 1) as f32,
                (corner >> 2) as f32,
            );
            if let Some(at) = level.brick_at(low + step * reach) {
                read[brick_number(bricks, at)] = true;
            }
        }
    });
    read
}

fn brick_number(bricks: UVec3, at: [u16; 3]) -> usize {
    let [x, y, z] = at.map(usize::from);
    (z * bricks.y as usize + y) * bricks.x as usize + x
}

/// Allocates the bricks that are read, the most urgent first. True if the memory bound was met.
fn store_bricks(
    field: &mut Field,
    number: usize,
    read: &[bool],
    memory_bytes: u64,
    urgency: Urgency<'_>,
) -> bool {
    let bricks = field.levels[number].bricks_per_axis();
    let positions = (0..read.len()).filter(|at| read[*at]).map(|at| {
        let (row, plane) = (bricks.x as usize, (bricks.x * bricks.y) as usize);
        [at % row, at % plane / row, at / plane].map(|c| c as u16)
    });
    allocate_urgent(field, number, positions, memory_bytes, urgency)
}

/// Allocates bricks that are not stored yet, the most urgent first. True if the memory bound was met.
pub(super) fn allocate_urgent(
    field: &mut Field,
    number: usize,
    positions: impl Iterator<Item = [u16; 3]>,
    memory_bytes: u64,
    urgency: Urgency<'_>,
) -> bool {
    let room = (memory_bytes.saturating_sub(field_bytes(field)) / BRICK_BYTES) as usize;
    let level = &mut field.levels[number];
    let half = Vec3::splat(level.brick_m() / 2.0);
    let missing = positions.filter(|at| level.brick(*at) == NULL_BRICK);
    let mut wanted: Vec<(f32, [u16; 3])> = missing
        .filter_map(|at| Some((urgency(level.brick_origin(at) + half, number)?, at)))
        .collect();
    let full = wanted.len() > room;
    if full {
        wanted.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        wanted.truncate(room);
    }
    level.reserve(wanted.len());
    for (_, at) in wanted {
        level.allocate(at);
    }
    full
}

/// Bytes of all stored bricks with optimiser state.
pub(super) fn field_bytes(field: &Field) -> u64 {
    let bricks: u64 = field
        .levels
        .iter()
        .map(|level| level.brick_count() as u64)
        .sum();
    bricks * BRICK_BYTES
}

/// Calls `visit(lower corner, edge)` for every occupied cell.
fn for_each_cell(mask: &Occupancy, mut visit: impl FnMut(Vec3, f32)) {
    let blocks = mask.blocks_per_axis();
    for (number, stored) in mask.index().iter().enumerate() {
        let number = number as u32;
        let block = UVec3::new(
            number % blocks.x,
            number / blocks.x % blocks.y,
            number / (blocks.x * blocks.y),
        );
        for (z, word) in mask.masks()[*stored as usize].iter().enumerate() {
            let mut word = *word;
            while word != 0 {
                let bit = word.trailing_zeros();
                word &= word - 1;
                let cell = block * BLOCK_SIDE + UVec3::new(bit & 7, bit >> 3, z as u32);
                visit(
                    mask.origin_m() + cell.as_vec3() * mask.cell_m(),
                    mask.cell_m(),
                );
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::background::empty_field;
    use super::super::preset::Budget;
    use super::*;

    #[test]
    fn the_most_urgent_bricks_are_stored_while_there_is_room() {
        let preset = TrainPreset::background(Budget::Quick);
        let stored = |urgency: Urgency<'_>, room: u64| {
            let mut field = empty_field(Vec3::ZERO, Vec3::splat(6.4), &preset, 1).unwrap();
            let all = (0..512u16).map(|n| [n % 8, n / 8 % 8, n / 64]);
            let bound = field_bytes(&field) + room * BRICK_BYTES;
            let full = allocate_urgent(&mut field, 2, all, bound, urgency);
            let positions = field.levels[2].positions().to_vec();
            (full, positions[positions.len() - room as usize..].to_vec())
        };
        let path = Vec3::new(6.0, 6.0, 0.0);
        let (full, near) = stored(&|p, _| Some(p.distance_squared(path)), 8);
        assert!(full && near.iter().all(|[x, y, z]| *x >= 5 && *y >= 5 && *z <= 2));
        let (full, by_number) = stored(&|_, _| Some(0.0), 8);
        assert!(full && by_number != near);
        assert!(!stored(&|p, _| (p.x < 0.8).then_some(0.0), 64).0);
    }
}
