//! Named ways to place objects: the paper's, target distributions and corner cases.

use serde::{Deserialize, Serialize};

use super::recipe::Jitter;

/// How poses are proposed. [`Recipe::new`](super::Recipe::new) fills in the values; a recipe may change any of them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PlacementPreset {
    /// A free place in the camera's view at an even spread of distances; vehicles head along the road, jittered, among the
    /// headings from which the asset was observed, people anywhere.
    #[default]
    Default,
    /// The paper's: a recorded pose relative to the ego, jittered; poses beyond the observed views are kept and flagged.
    Paper,
    /// The paper's without rotation and translation: recorded poses as they are.
    PaperNoRt,
    /// Every 30 degrees of camera-relative heading that the assets' coverage allows equally often.
    BalancedHeading,
    /// Far from the camera.
    Far,
    /// Many objects.
    Dense,
    /// Corner case: partly hidden by the environment.
    Occluded,
    /// Corner case: across the road.
    StrangeHeading,
    /// Corner case: on ground that rises or falls.
    OnSlope,
    /// Corner case: close ahead beside the ego's lane and turned into it.
    CutIn,
    /// Corner case: bumper to bumper.
    DenseQueue,
}

/// What a preset sets in a recipe.
#[derive(Clone, Copy, Debug)]
pub(super) struct PresetValues {
    pub(super) objects: (u32, u32),
    pub(super) jitter: Jitter,
    pub(super) heading_bins: Option<usize>,
    pub(super) distance_m: [f64; 2],
    pub(super) clear_fraction: [f64; 2],
    pub(super) min_slope: f64,
    pub(super) min_height_px: f64,
    pub(super) coverage_slack_rad: f64,
}

const DEGREE: f64 = std::f64::consts::PI / 180.0;

/// Traffic keeps its lane; more would look staged.
const ROAD_JITTER: Jitter = Jitter {
    x_m: 0.0,
    y_m: 0.0,
    heading_rad: 10.0 * DEGREE,
};
/// Section 4.2 of the paper: T_x, T_y, T_theta.
const PAPER_JITTER: Jitter = Jitter {
    x_m: 20.0,
    y_m: 5.0,
    heading_rad: 30.0 * DEGREE,
};
const NO_JITTER: Jitter = Jitter {
    x_m: 0.0,
    y_m: 0.0,
    heading_rad: 0.0,
};

/// The bins of `balanced-heading`: 30 degrees.
const BALANCED_BINS: usize = 12;

/// What presets share unless they say otherwise.
const COMMON: PresetValues = PresetValues {
    objects: (1, 3),
    jitter: ROAD_JITTER,
    heading_bins: None,
    // Nearer, a 0.05 m voxel is over 3 px; further, a car is under 20 px high.
    distance_m: [6.0, 40.0],
    // Less than a third in sight teaches a detector little.
    clear_fraction: [0.35, 1.0],
    min_slope: 0.0,
    // Likewise.
    min_height_px: 12.0,
    // The design starts at 20 degrees. Measured on the generated street, a following car's unseen side then shows as coloured
    // fog over a third of its width; at 8 degrees a sliver of it at most.
    coverage_slack_rad: 8.0 * DEGREE,
};

impl PlacementPreset {
    pub const ALL: [Self; 11] = [
        Self::Default,
        Self::Paper,
        Self::PaperNoRt,
        Self::BalancedHeading,
        Self::Far,
        Self::Dense,
        Self::Occluded,
        Self::StrangeHeading,
        Self::OnSlope,
        Self::CutIn,
        Self::DenseQueue,
    ];

    /// Whether poses come from the recorded ones, as the paper's do, and views beyond coverage are flagged instead of avoided.
    pub fn jitters_recorded_poses(self) -> bool {
        matches!(self, Self::Paper | Self::PaperNoRt)
    }

    pub(super) fn values(self) -> PresetValues {
        match self {
            Self::Default => COMMON,
            Self::Paper => PresetValues {
                // "1-2 new objects": the recorded distances and 20 m of jitter.
                objects: (1, 2),
                jitter: PAPER_JITTER,
                distance_m: [6.0, 80.0],
                ..COMMON
            },
            Self::PaperNoRt => PresetValues {
                objects: (1, 2),
                jitter: NO_JITTER,
                distance_m: [6.0, 80.0],
                ..COMMON
            },
            Self::BalancedHeading => PresetValues {
                heading_bins: Some(BALANCED_BINS),
                ..COMMON
            },
            Self::Far => PresetValues {
                distance_m: [30.0, 70.0],
                // A car at 70 m and 400 px of focal length.
                min_height_px: 8.0,
                ..COMMON
            },
            Self::Dense => PresetValues {
                objects: (6, 12),
                distance_m: [6.0, 60.0],
                // Dense traffic hides itself.
                clear_fraction: [0.15, 1.0],
                min_height_px: 8.0,
                ..COMMON
            },
            Self::Occluded => PresetValues {
                objects: (1, 2),
                clear_fraction: [0.2, 0.75],
                ..COMMON
            },
            Self::StrangeHeading => PresetValues {
                objects: (1, 1),
                ..COMMON
            },
            Self::CutIn => PresetValues {
                objects: (1, 1),
                // The distance at which a driver must brake.
                distance_m: [6.0, 20.0],
                ..COMMON
            },
            Self::OnSlope => PresetValues {
                min_slope: 0.03,
                ..COMMON
            },
            Self::DenseQueue => PresetValues {
                objects: (4, 8),
                jitter: Jitter {
                    heading_rad: 3.0 * DEGREE,
                    ..NO_JITTER
                },
                distance_m: [6.0, 60.0],
                clear_fraction: [0.05, 1.0],
                min_height_px: 8.0,
                ..COMMON
            },
        }
    }
}
