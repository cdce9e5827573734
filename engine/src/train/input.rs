//! What a field is trained from, and what comes out.

use glam::DVec3;

use crate::field::Field;
use crate::quality::QualityReport;
use crate::view::TrainView;

/// A static scene. All coordinates in the log's local frame, z up, metres.
#[derive(Clone, Debug, Default)]
pub struct BackgroundInput {
    pub views: Vec<TrainView>,
    /// Returns of the static scene, all sweeps of the training frames, and what stands in for returns: points of depth maps and
    /// of structure from motion. They seed bricks and density, and bound the box.
    pub lidar_points: Vec<[f32; 3]>,
    /// Ways of LiDAR pulses in every direction, of training frames: the space up to a return is free, whether or not a camera
    /// saw it.
    pub beams: Vec<LidarBeam>,
    /// Camera or ego positions of the drive, in order; the finest voxels follow them.
    pub ego_path: Vec<DVec3>,
}

/// The way of one LiDAR pulse.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LidarBeam {
    /// The sensor at the pulse's time.
    pub origin_m: [f32; 3],
    pub return_m: [f32; 3],
    /// Index of a view that was taken with the sweep, whose pose correction applies.
    pub view: u32,
}

/// One rigid object. All coordinates in its cuboid's frame (origin at the centre, x forward, y left, z up), metres.
#[derive(Clone, Debug, Default)]
pub struct ObjectInput {
    pub views: Vec<TrainView>,
    /// Full extents of the annotated cuboid (length, width, height).
    pub size_m: DVec3,
    /// Also supervise every ray's mirror image about the x-z plane.
    pub symmetric: bool,
    /// Returns on the object, all usable sweeps.
    pub lidar_points: Vec<[f32; 3]>,
}

/// A bounded scene seen from outside, in front of one colour.
#[derive(Clone, Debug, Default)]
pub struct BoundedInput {
    pub views: Vec<TrainView>,
    /// The box that holds the scene, in the views' local frame, metres.
    pub low_m: DVec3,
    pub high_m: DVec3,
    /// sRGB behind the scene, 0..1.
    pub backdrop: [f32; 3],
}

/// A fitted field and how good it is.
#[derive(Clone, Debug)]
pub struct Trained {
    pub field: Field,
    pub quality: QualityReport,
}
