//! What a budget means for a job.

use backlot_engine::scene::RegionConfig;
use backlot_engine::train::{Budget as EngineBudget, TrainPreset};

use crate::domain::job::Budget;

/// Images are shrunk to this longer side: 1242 x 375 trains at 621 x 188, 640 x 384 as it is.
const LONGER_SIDE_PX: u32 = 800;

/// Usable frames that every budget needs of an object at least: tracks with fewer are not decomposed.
pub(super) const LEAST_FRAMES: usize = 8;

/// Settings of one job.
#[derive(Clone, Debug)]
pub(super) struct Plan {
    pub background: TrainPreset,
    pub object: TrainPreset,
    pub region: RegionConfig,
    pub longer_side_px: u32,
    /// Usable frames without which an object is not trained.
    pub least_frames: usize,
    /// Objects trained, those with most pixels first.
    pub most_objects: usize,
}

impl Plan {
    pub(super) fn new(budget: Budget) -> Self {
        let engine = match budget {
            Budget::Quick => EngineBudget::Quick,
            Budget::Standard => EngineBudget::Standard,
            Budget::Paper => EngineBudget::Paper,
        };
        let (longer_side_px, least_frames, most_objects) = match budget {
            Budget::Quick => (LONGER_SIDE_PX, LEAST_FRAMES, 5),
            Budget::Standard => (LONGER_SIDE_PX, LEAST_FRAMES, 8),
            // Section 4.2: 20 to 60 frames an object, at full resolution.
            Budget::Paper => (u32::MAX, 20, 64),
        };
        let background = TrainPreset::background(engine);
        let region = match budget {
            Budget::Paper => {
                RegionConfig::paper(background.voxels_m.last().copied().map_or(0.25, f64::from))
            }
            _ => RegionConfig::default(),
        };
        Self {
            background,
            object: TrainPreset::object(engine),
            region,
            longer_side_px,
            least_frames,
            most_objects,
        }
    }
}
