//! One labelled object through time.

use backlot_engine::camera::Rigid;
use backlot_engine::class::ObjectClass;
use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::trajectory::interpolate;

/// One object through time; its cuboid's frame is centred, x forward, y left, z up.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Track {
    /// Unique in the log.
    pub track_id: String,
    pub class: ObjectClass,
    /// The data set's own class name.
    pub source_class: String,
    /// Full extents in metres, constant over the track.
    pub size_m: DVec3,
    /// Strictly increasing in time.
    pub states: Vec<TrackState>,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct TrackState {
    pub timestamp_ns: i64,
    pub world_from_cuboid: Rigid,
    pub occlusion: Occlusion,
    /// Fraction outside the image as the data set says it; negative if unknown.
    pub truncation: f32,
}

/// How much of the object the data set says is hidden.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Occlusion {
    #[default]
    Unknown,
    None,
    Partly,
    Largely,
}

impl Track {
    /// World from cuboid at `timestamp_ns`, interpolated between states; `None` outside them.
    pub fn at(&self, timestamp_ns: i64) -> Option<Rigid> {
        interpolate(&self.states, timestamp_ns, |s| {
            (s.timestamp_ns, s.world_from_cuboid)
        })
    }

    /// The state nearest in time.
    pub fn nearest_state(&self, timestamp_ns: i64) -> Option<&TrackState> {
        self.states
            .iter()
            .min_by_key(|s| s.timestamp_ns.abs_diff(timestamp_ns))
    }
}
