//! Depth that a log brings instead of LiDAR: maps of single images, and points of structure from motion.

use serde::{Deserialize, Serialize};

use crate::domain::blob::BlobRef;

/// Value of a depth map's pixel whose depth is not known.
pub const DEPTH_UNKNOWN: u16 = 0;
/// Bytes of a point: little-endian f64 x, y, z.
pub const SFM_POINT_BYTES: usize = 24;
/// Bytes of an observation: little-endian u32 index of the point, u32 index into the log's frames.
pub const OBSERVATION_BYTES: usize = 8;

/// Depth of one image.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DepthMap {
    /// 16-bit grey PNG of the image's size: [`DEPTH_UNKNOWN`], or camera z at the pixel's centre in units.
    pub image: BlobRef,
    /// Metres of camera z (not of distance along the ray) in one unit.
    pub unit_m: f64,
    pub kind: DepthMapKind,
    /// Weight of a sample's loss relative to a LiDAR return's; `None` is the kind's own.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub weight: Option<f64>,
}

/// How a depth map was made, which says how far it may be trusted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum DepthMapKind {
    /// Triangulated between cameras of known baseline.
    Stereo,
    /// Guessed from one image and brought to metres.
    Monocular,
}

/// Static points of structure from motion in the world frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SfmPoints {
    /// [`SFM_POINT_BYTES`] a point, metres.
    pub points: BlobRef,
    /// [`OBSERVATION_BYTES`] each: which frame saw which point.
    pub observations: Option<BlobRef>,
    /// Weight of a point's loss relative to a LiDAR return's; `None` is the default.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub weight: Option<f64>,
}
