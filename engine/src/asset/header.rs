//! The asset header.

use glam::DVec3;
use serde::{Deserialize, Serialize};

use crate::camera::Rigid;
use crate::class::ObjectClass;
use crate::quality::{QualityReport, ViewCoverage};
use crate::scene::{Recording, ValidRegion};

/// Version of the stored format; readers refuse newer ones and read all older ones.
pub const FORMAT_VERSION: u32 = 2;

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "SCREAMING_SNAKE_CASE")]
pub enum AssetKind {
    Background,
    Object,
}

/// What the asset is good for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "SCREAMING_SNAKE_CASE")]
pub enum Usage {
    /// Passed the quality gate: may be placed anywhere its view coverage allows.
    Library,
    /// Good only near its recorded poses.
    ReplayOnly,
}

/// The space the field's colours live in and are composited in.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "SCREAMING_SNAKE_CASE")]
pub enum ColorSpace {
    #[default]
    Srgb,
}

/// Everything about an asset but its field.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct AssetHeader {
    pub format_version: u32,
    pub kind: AssetKind,
    /// Objects; `Other` for a background.
    pub class: ObjectClass,
    /// Objects: full extents of the annotated cuboid in metres (length, width, height); zero for a background.
    pub size_m: DVec3,
    /// Whether training used the mirror symmetry about the x-z plane.
    pub symmetric: bool,
    pub usage: Usage,
    /// Why the usage is `ReplayOnly`; empty otherwise.
    pub usage_reason: String,
    /// Backgrounds: where the log's world lies in the field's local frame. Identity for an object.
    pub local_from_world: Rigid,
    pub source_log: String,
    /// Objects: the track; empty for a background.
    pub source_track_id: String,
    /// Trained on synthetic images.
    pub synthetic: bool,
    pub quality: QualityReport,
    /// Objects.
    pub coverage: Option<ViewCoverage>,
    /// Backgrounds: cameras, poses and tracks of the log.
    pub recording: Option<Recording>,
    /// Backgrounds: where objects may stand.
    #[serde(default)]
    pub valid_region: Option<ValidRegion>,
    /// Objects: where the track was recorded, relative to its ego at each usable frame; empty for a background.
    #[serde(default)]
    pub ego_from_object: Vec<Rigid>,
    pub color_space: ColorSpace,
    /// Exposure relative to the log's, in stops.
    pub exposure_ev: f64,
}
