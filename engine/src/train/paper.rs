//! The presets with the constants of Drive-3DAug, on top of DVGO's recipe for unbounded scenes where the paper is silent.

use super::options::TrainOptions;
use super::preset::{Budget, Surveys, TrainPreset};
use super::ray::{DepthForm, RayLosses};
use super::sampler::RayMix;

/// 330^3: a number of voxels, not a cube.
const VOXELS: u64 = 330 * 330 * 330;
/// "0.25-0.3 m".
const VOXEL_M: (f64, f64) = (0.25, 0.3);
/// DVGO's fast colour thresholds for unbounded scenes, whose steps 1,500 to 5,500 are of 40,000.
const THRESHOLDS: [(f64, f32); 6] = [
    (0.0, 5e-6),
    (0.0375, 1e-5),
    (0.0625, 2.5e-5),
    (0.0875, 3.33e-5),
    (0.1125, 5e-5),
    (0.1375, 1e-4),
];
/// Coloured samples of a step: DVGO starts on a grid of 50^3, where rays have few; here the first steps take fewer rays.
const MOST_COLORED: u64 = 1 << 19;
/// What DVGO leaves of its rates.
const RATE_DECAY: f32 = 0.1;
/// Open space is cleared as early as DVGO's grid grows, at steps 2,000 to 16,000.
const SURVEYS: [f64; 5] = [0.02, 0.05, 0.1, 0.2, 0.4];

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
            most_colored: MOST_COLORED,
            rate_decay: RATE_DECAY,
            surveys: Surveys::AtFractions(SURVEYS.to_vec()),
            // 36 M voxels with their optimiser state are 2.2 GB.
            memory_bytes: 3 << 30,
            mix: RayMix {
                depth_weight: 1.0,
                beam_rays: 0,
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
                average_last: 0.0,
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
