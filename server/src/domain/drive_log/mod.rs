//! The driving log as the service keeps it: plain f64 types, checked on arrival by `ingest`.
//!
//! Conventions are those of the wire: metres, radians, int64 nanoseconds; camera frames x right, y down, z forward; every other
//! frame x forward, y left, z up; transforms are named `target_from_source`.

mod depth;
mod track;
mod trajectory;

pub use depth::{
    DEPTH_UNKNOWN, DepthMap, DepthMapKind, OBSERVATION_BYTES, SFM_POINT_BYTES, SfmPoints,
};
pub use track::{Occlusion, Track, TrackState};
pub use trajectory::{TimedPose, Trajectory};

use backlot_engine::camera::{Camera, Rigid};
use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::blob::BlobRef;
use super::ids::DriveLogId;
use crate::error::ErrorKind;

/// Version of the stored manifest's form.
pub const MANIFEST_VERSION: u32 = 1;

/// Value of a mask pixel that belongs to no instance.
pub const MASK_NONE: u16 = 0;
/// Value of a mask pixel whose instance is not known.
pub const MASK_UNKNOWN: u16 = u16::MAX;

/// A drive as recorded. Nothing is assumed to be synchronous.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DriveLog {
    pub version: u32,
    pub id: DriveLogId,
    /// Data set form it came from, e.g. "kitti-raw".
    pub dataset: String,
    /// Images are synthetic.
    pub synthetic: bool,
    /// Anchor of the log: fields are trained in the local frame, where f32 is exact enough.
    pub local_from_world: Rigid,
    pub cameras: Vec<LogCamera>,
    /// World from ego.
    pub world_from_ego: Trajectory,
    pub frames: Vec<CameraFrame>,
    pub sweeps: Vec<LidarSweep>,
    /// Absent in manifests of logs that have none, so that a log's bytes, and with them its identity, stay what they were.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sfm_points: Option<SfmPoints>,
    pub tracks: Vec<Track>,
    /// What the reader ignored or assumed.
    pub notes: Vec<String>,
    /// Unit vector from the ground towards the sun.
    pub sun_direction_world: Option<DVec3>,
}

/// A camera and where it is mounted.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LogCamera {
    /// Unique in the log.
    pub camera_id: String,
    pub camera: Camera,
    pub ego_from_camera: Rigid,
}

/// One image of one camera.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CameraFrame {
    pub camera_id: String,
    /// As the data set counts it; unique per camera.
    pub frame_index: u32,
    /// Middle of the exposure of the middle row or column.
    pub timestamp_ns: i64,
    /// 0 if unknown.
    pub exposure_ns: i64,
    /// First to last row or column; 0 for a global shutter.
    pub readout_ns: i64,
    pub readout_direction: ReadoutDirection,
    /// PNG or JPEG in sRGB.
    pub image: BlobRef,
    /// 16-bit grey PNG: [`MASK_NONE`], [`MASK_UNKNOWN`], or 1 + index into the log's tracks.
    pub instance_mask: Option<BlobRef>,
    /// 8-bit grey PNG: 255 = sky.
    pub sky_mask: Option<BlobRef>,
    /// Absent in manifests as [`DriveLog::sfm_points`] is.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub depth_map: Option<DepthMap>,
    /// Instead of `instance_mask`, 16-bit grey PNG: [`MASK_NONE`], [`MASK_UNKNOWN`], or an instance of this frame alone. Left out of the
    /// stored form where there is none, so that logs of before have the same bytes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub free_instance_mask: Option<BlobRef>,
}

/// The side from which a rolling shutter reads out.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ReadoutDirection {
    #[default]
    Unknown,
    TopToBottom,
    BottomToTop,
    LeftToRight,
    RightToLeft,
}

/// One turn of a LiDAR.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LidarSweep {
    pub lidar_id: String,
    /// Time of the points that carry no time of their own.
    pub timestamp_ns: i64,
    pub ego_from_lidar: Rigid,
    /// Points in the LiDAR frame.
    pub points: BlobRef,
    pub format: PointFormat,
}

/// Layout of a sweep's points.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PointFormat {
    /// Little-endian f32 x, y, z in metres and intensity.
    XyziF32,
    /// As above, then f32 seconds after the sweep's timestamp.
    XyzitF32,
}

impl PointFormat {
    pub fn point_bytes(self) -> usize {
        match self {
            Self::XyziF32 => 16,
            Self::XyzitF32 => 20,
        }
    }
}

/// A stored manifest cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum ManifestError {
    #[error("manifest is not readable")]
    Unreadable(#[from] serde_json::Error),
    #[error("manifest has version {found}, this server reads {MANIFEST_VERSION}")]
    Version { found: u32 },
}

impl ManifestError {
    pub fn kind(&self) -> ErrorKind {
        ErrorKind::Corrupt
    }
}

impl DriveLog {
    /// The stored form (JSON). Equal logs have equal bytes, so the digest of these is the identity of the log's content.
    pub fn to_manifest(&self) -> Vec<u8> {
        serde_json::to_vec(self).expect("plain structs with text keys serialise")
    }

    /// Reads what [`Self::to_manifest`] wrote.
    ///
    /// # Errors
    /// [`ManifestError`] if the bytes are not a manifest of this version.
    pub fn from_manifest(bytes: &[u8]) -> Result<Self, ManifestError> {
        #[derive(Deserialize)]
        struct Versioned {
            version: u32,
        }
        let Versioned { version } = serde_json::from_slice(bytes)?;
        if version != MANIFEST_VERSION {
            return Err(ManifestError::Version { found: version });
        }
        Ok(serde_json::from_slice(bytes)?)
    }

    pub fn camera(&self, camera_id: &str) -> Option<&LogCamera> {
        self.cameras.iter().find(|c| c.camera_id == camera_id)
    }

    /// World from camera at the frame's time; `None` if the camera is unknown or the ego trajectory does not cover the time.
    pub fn world_from_camera(&self, frame: &CameraFrame) -> Option<Rigid> {
        let camera = self.camera(&frame.camera_id)?;
        let world_from_ego = self.world_from_ego.at(frame.timestamp_ns)?;
        Some(world_from_ego * camera.ego_from_camera)
    }

    /// Every blob the manifest names, repeats included.
    pub fn blobs(&self) -> impl Iterator<Item = &BlobRef> {
        let of_frames = self.frames.iter().flat_map(|f| {
            std::iter::once(&f.image)
                .chain(&f.instance_mask)
                .chain(&f.sky_mask)
                .chain(f.depth_map.as_ref().map(|d| &d.image))
                .chain(&f.free_instance_mask)
        });
        let of_points = self
            .sfm_points
            .iter()
            .flat_map(|sfm| std::iter::once(&sfm.points).chain(&sfm.observations));
        of_frames
            .chain(self.sweeps.iter().map(|s| &s.points))
            .chain(of_points)
    }
}
