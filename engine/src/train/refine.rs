//! Prunes what stayed empty and stores finer bricks where something is.

use glam::{UVec3, Vec3};

use super::preset::TrainPreset;
use super::survey::{dilate, is_dense, survey};
use crate::backend::cpu::CpuTrainer;
use crate::field::occupancy::BLOCK_SIDE;
use crate::field::{BRICK_NODES, FEATURES, Field, Occupancy};

/// Bytes per node: density and 12 features, and one second moment for each of the two.
pub(super) const NODE_BYTES: u64 = 4 * (1 + FEATURES as u64 + 2);

/// Bytes of one brick with its optimiser state.
pub(super) const BRICK_BYTES: u64 = BRICK_NODES as u64 * NODE_BYTES;

/// Surveys the field, drops bricks no occupied cell reads, and stores bricks at occupied cells wherever `allowed`.
///
/// Returns a warning if the memory bound kept bricks from being stored.
pub(super) fn refine(
    trainer: &mut CpuTrainer,
    preset: &TrainPreset,
    allowed: &(dyn Fn(Vec3, usize) -> bool + Sync),
) -> Option<String> {
    let field = trainer.field();
    let old = &field.occupancy;
    let alpha = preset.survey_alpha;
    let dense = survey(field, |centre| {
        !matches!(old.at(centre), crate::field::occupancy::Space::Empty { .. })
            && is_dense(field, centre, alpha)
    });
    let grown = dilate(field, &dense);
    prune(trainer, &grown);
    let full = store_bricks(trainer.field_mut(), &grown, preset.memory_bytes, allowed);
    // Steps follow the finest stored voxel, which may have changed.
    let field = trainer.field();
    let stepped = survey(field, |centre| {
        !matches!(
            grown.at(centre),
            crate::field::occupancy::Space::Empty { .. }
        )
    });
    trainer.field_mut().occupancy = stepped;
    full.then(|| {
        format!(
            "the memory bound of {} MiB kept fine voxels from being stored everywhere",
            preset.memory_bytes >> 20
        )
    })
}

/// Drops every brick whose nodes no occupied cell interpolates.
fn prune(trainer: &mut CpuTrainer, occupied: &Occupancy) {
    for number in 0..trainer.field().levels.len() {
        let level = &trainer.field().levels[number];
        let mut used = vec![false; level.brick_count()];
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
                    used[level.brick(at) as usize] = true;
                }
            }
        });
        trainer.retain_bricks(number, |brick| used[brick as usize]);
    }
}

/// Allocates bricks around occupied cells. True if the memory bound was met.
pub(super) fn store_bricks(
    field: &mut Field,
    occupied: &Occupancy,
    memory_bytes: u64,
    allowed: &(dyn Fn(Vec3, usize) -> bool + Sync),
) -> bool {
    let mut full = false;
    for number in 0..field.levels.len() {
        let mut wanted = std::collections::BTreeSet::new();
        let level = &field.levels[number];
        for_each_cell(occupied, |low, side_m| {
            for corner in 0..8 {
                let step = Vec3::new(
                    (corner & 1) as f32,
                    (corner >> 1 & 1) as f32,
                    (corner >> 2) as f32,
                );
                let p = low + step * (side_m + level.voxel_m());
                let Some(at) = level.brick_at(p) else {
                    continue;
                };
                if level.brick(at) == 0 && allowed(p, number) {
                    wanted.insert(at);
                }
            }
        });
        let room = (memory_bytes.saturating_sub(field_bytes(field)) / BRICK_BYTES) as usize;
        full |= wanted.len() > room;
        let level = &mut field.levels[number];
        level.reserve(wanted.len().min(room));
        for at in wanted.into_iter().take(room) {
            level.allocate(at);
        }
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
