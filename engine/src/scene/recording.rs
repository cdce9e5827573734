//! What a background remembers of its log: where the cameras were and which objects stood where.

use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::daylight::{Daylight, SunSource};
use crate::camera::{Camera, Rigid};
use crate::class::ObjectClass;
use crate::{Error, Result};

/// The part of a drive log that composition needs, in the background's local frame. Lives in background asset headers.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Recording {
    pub cameras: Vec<RecordedCamera>,
    /// In time order per camera.
    pub frames: Vec<RecordedFrame>,
    pub tracks: Vec<RecordedTrack>,
    /// Unit vector from the ground towards the sun; `None` if unknown.
    pub sun_direction_local: Option<DVec3>,
    /// The sunlight as the background shows it; `None` if it was not measured, or neither the log nor a shadow tells the sun.
    #[serde(default)]
    pub daylight: Option<Daylight>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RecordedCamera {
    pub camera_id: String,
    /// At the recorded image size.
    pub camera: Camera,
}

/// One image's pose. Everything is at the frame's own timestamp.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RecordedFrame {
    pub camera_id: String,
    pub frame_index: u32,
    pub timestamp_ns: i64,
    pub local_from_camera: Rigid,
    pub local_from_ego: Rigid,
    /// Content digest of the recorded image, for whoever holds the blobs; `None` if it is not to be had.
    #[serde(default)]
    pub image: Option<String>,
    /// Digest of the log's instance mask of that image: 16-bit, 0 or 1 + index into [`Recording::tracks`].
    #[serde(default)]
    pub instance_mask: Option<String>,
}

/// One labelled object through the frames.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RecordedTrack {
    pub track_id: String,
    pub class: ObjectClass,
    /// Full extents in metres: x = length, y = width, z = height.
    pub size_m: DVec3,
    /// Movers are masked out of the background's training; the others are part of it.
    pub moving: bool,
    /// Pose of the cuboid's centre frame at each of [`Recording::frames`] (same order and length); `None` where the track has none.
    pub local_from_cuboid: Vec<Option<Rigid>>,
}

impl Recording {
    /// Checks that indices and lengths agree.
    ///
    /// # Errors
    /// [`Error::Invalid`] naming the frame or track.
    pub fn validate(&self) -> Result<()> {
        for frame in &self.frames {
            if self.camera(&frame.camera_id).is_none() {
                return Err(Error::invalid(format!(
                    "frame {} names unknown camera \"{}\"",
                    frame.frame_index, frame.camera_id
                )));
            }
            if !frame.local_from_camera.is_finite() || !frame.local_from_ego.is_finite() {
                return Err(Error::invalid(format!(
                    "frame {} of camera {}: pose is not finite",
                    frame.frame_index, frame.camera_id
                )));
            }
        }
        for track in &self.tracks {
            if track.local_from_cuboid.len() != self.frames.len() {
                return Err(Error::invalid(format!(
                    "track {} has {} poses for {} frames",
                    track.track_id,
                    track.local_from_cuboid.len(),
                    self.frames.len()
                )));
            }
            if !track
                .local_from_cuboid
                .iter()
                .flatten()
                .all(Rigid::is_finite)
            {
                return Err(Error::invalid(format!(
                    "track {}: pose is not finite",
                    track.track_id
                )));
            }
        }
        Ok(())
    }

    /// The sunlight as measured, else a clear day's from the sun of the log; `None` where neither is known.
    pub fn light(&self) -> Option<Daylight> {
        let of_log = |sun| Daylight::clear_sky(sun, SunSource::Log);
        self.daylight
            .or_else(|| self.sun_direction_local.and_then(of_log))
    }

    pub fn camera(&self, camera_id: &str) -> Option<&Camera> {
        self.cameras
            .iter()
            .find(|c| c.camera_id == camera_id)
            .map(|c| &c.camera)
    }

    /// The tracks that have a pose at a frame, as (track index, track, pose).
    pub fn tracks_at(
        &self,
        frame: usize,
    ) -> impl Iterator<Item = (usize, &RecordedTrack, Rigid)> + '_ {
        self.tracks
            .iter()
            .enumerate()
            .filter_map(move |(i, track)| {
                track.local_from_cuboid[frame].map(|pose| (i, track, pose))
            })
    }
}
