//! The flat box of a background whose every voxel is stored.

use glam::{DVec3, Vec3};

use super::preset::TrainPreset;
use super::refine::NODE_BYTES;
use crate::field::BRICK_SIDE;
use crate::{Error, Result};

/// How much the box shrinks towards the path at each try.
const SHRINK: f64 = 0.95;
/// A box that reaches less far than this beside the path holds no street.
const LEAST_REACH_M: f64 = 5.0;

/// Box and voxel edge: the smallest voxel of the preset's range at which the box of `bounds(reach)` holds no more than its voxels,
/// with the reach shrunk until there is one.
///
/// # Errors
/// [`Error::OutOfMemory`] if the path alone needs more voxels, or if its voxels need more than the preset's memory.
pub(super) fn dense_box(
    preset: &TrainPreset,
    bounds: impl Fn(f64) -> (Vec3, Vec3),
) -> Result<(Vec3, Vec3, f32)> {
    let (least_m, most_m) = preset.options.dense_voxel_m;
    let mut reach_m = preset.box_reach_m;
    loop {
        let (low, high) = bounds(reach_m);
        let volume = (high - low).as_dvec3().element_product();
        let mut voxel_m = (volume / preset.options.dense_voxels as f64)
            .cbrt()
            .max(least_m);
        // Bricks are stored whole, so a box that is just full may need a little larger voxels.
        while voxel_m <= most_m && voxels(low, high, voxel_m) > preset.options.dense_voxels {
            voxel_m *= 1.002;
        }
        let fits = voxel_m <= most_m;
        if !fits && reach_m * SHRINK > LEAST_REACH_M {
            reach_m *= SHRINK;
            continue;
        }
        let needed_bytes = voxels(low, high, voxel_m) * NODE_BYTES;
        if !fits || needed_bytes > preset.memory_bytes {
            let bound = preset.options.dense_voxels * NODE_BYTES;
            return Err(Error::OutOfMemory {
                what: "the background's dense box",
                needed_bytes,
                available_bytes: preset.memory_bytes.min(bound),
            });
        }
        return Ok((low, high, voxel_m as f32));
    }
}

/// Voxels of the whole bricks that cover the box.
fn voxels(low: Vec3, high: Vec3, voxel_m: f64) -> u64 {
    let brick_m = voxel_m * BRICK_SIDE as f64;
    let bricks: DVec3 = ((high - low).as_dvec3() / brick_m).ceil();
    (bricks * BRICK_SIDE as f64).element_product() as u64
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A path of this length along x.
    fn along(path_m: f64) -> impl Fn(f64) -> (Vec3, Vec3) {
        move |reach_m| {
            let low = DVec3::new(-reach_m, -reach_m, -2.0);
            let high = DVec3::new(path_m + reach_m, reach_m, 14.0);
            (low.as_vec3(), high.as_vec3())
        }
    }

    #[test]
    fn a_short_path_gets_the_finest_voxels_and_a_long_one_coarser_ones() {
        let mut preset = TrainPreset::paper_background();
        preset.box_reach_m = 50.0;
        let (low, high, voxel_m) = dense_box(&preset, along(20.0)).unwrap();
        assert_eq!(voxel_m, 0.25);
        assert_eq!(high.x - low.x, 120.0);
        preset.box_reach_m = 100.0;
        let (low, high, voxel_m) = dense_box(&preset, along(150.0)).unwrap();
        assert!((0.25..=0.3).contains(&voxel_m), "{voxel_m}");
        assert!(high.x - low.x > 150.0);
        assert!(voxels(low, high, f64::from(voxel_m)) <= preset.options.dense_voxels);
    }

    #[test]
    fn a_path_too_long_or_too_little_memory_is_refused_with_both_figures() {
        let preset = TrainPreset::paper_background();
        let error = dense_box(&preset, along(9_000.0)).unwrap_err();
        assert!(matches!(error, Error::OutOfMemory { .. }), "{error}");
        let small = TrainPreset {
            memory_bytes: 1 << 20,
            ..preset
        };
        let error = dense_box(&small, along(50.0)).unwrap_err();
        assert!(
            matches!(error, Error::OutOfMemory { available_bytes, .. } if available_bytes == 1 << 20),
            "{error}"
        );
    }
}
