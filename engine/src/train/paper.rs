//! The presets with the constants of Drive-3DAug, on top of DVGO's recipe for unbounded scenes where the paper is silent.

use super::options::TrainOptions;
use super::preset::{Budget, TrainPreset};
use super::ray::{DepthForm, RayLosses};
use super::sampler::RayMix;

/// 330^3: a number of voxels, not a cube.
const VOXELS: u64 = 330 * 330 * 330;
/// "0.25-0.3 m".
const VOXEL_M: (f64, f64) = (0.25, 0.3);
/// DVGO's fast colour thresholds for unbounded scenes.
const THRESHOLDS: [(u64, f32); 7] = [
    (0, 5e-6),
    (1_500, 1e-5),
    (2_500, 2.5e-5),
    (3_500, 3.33e-5),
    (4_500, 5e-5),
    (5_500, 1e-4),
    (6_500, 1e-4),
];

impl TrainPreset {
    /// A dense flat box of at most 36 M voxels of 0.25 to 0.3 m, 40,000 steps of 4,096 rays, colour and L1 depth at equal weight.
    pub fn paper_background() -> Self {
        let base = Self::background(Budget::Standard);
        Self {
            voxels_m: vec![VOXEL_M.0 as f32],
            level_reach_m: vec![f32::INFINITY],
            alpha_init: 1e-4,
            mlp_width: 128,
            steps: 40_000,
            most_passes: f64::INFINITY,
            // 36 M voxels with their optimiser state are 2.2 GB.
            memory_bytes: 3 << 30,
            mix: RayMix {
                depth_weight: 1.0,
                ..base.mix
            },
            losses: RayLosses {
                sample_color: 0.01,
                depth: DepthForm::CompositedL1,
                distortion: 0.01,
                density_variation: 1e-3,
                ..base.losses
            },
            options: TrainOptions {
                dense_voxels: VOXELS,
                dense_voxel_m: VOXEL_M,
                min_weights: THRESHOLDS.to_vec(),
                ..base.options
            },
            ..base
        }
    }

    /// About a thousand voxels of 0.25 m, L1 depth at weight 1. The rectified loss stays the cross-entropy: as printed it cannot
    /// do what the paper reports.
    pub fn paper_object() -> Self {
        let base = Self::object(Budget::Standard);
        Self {
            voxels_m: vec![VOXEL_M.0 as f32],
            level_reach_m: vec![f32::INFINITY],
            mlp_width: 128,
            steps: 10_000,
            most_passes: f64::INFINITY,
            mix: RayMix {
                depth_weight: 1.0,
                ..base.mix
            },
            losses: RayLosses {
                sample_color: 0.01,
                depth: DepthForm::CompositedL1,
                ..base.losses
            },
            ..base
        }
    }
}
