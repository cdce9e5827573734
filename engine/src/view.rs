//! Training views: what a field is fitted to.

use glam::DVec2;

use crate::camera::{Camera, Rigid};
use crate::field::Ray;

/// What a pixel is to the field being trained.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum PixelLabel {
    /// Supervises nothing: another instance, a mover, ego hood, the band between LiDAR hull and projected cuboid.
    Unknown = 0,
    /// Belongs to the field: static scene for a background, the object for an object.
    Foreground = 1,
    /// Objects only: provably not the object, so the rectified loss pushes accumulation to 0.
    Background = 2,
    /// Backgrounds only: sky at infinity; accumulation of the field is pushed to 0.
    Sky = 3,
}

/// What a depth comes from, which decides what it proves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DepthSource {
    /// Measured: the way to it is free.
    Lidar,
    /// A pixel of a depth map, wrong by a part of its range.
    Map,
    /// A point of structure from motion: too sparse to prove anything about the pixels around it.
    SfmPoint,
}

impl DepthSource {
    /// The part of a range by which it may be wrong, so that the rest is free; `None` if it proves nothing about the pixels around.
    pub fn slack(self) -> Option<f32> {
        match self {
            Self::Lidar => Some(0.0),
            Self::Map => Some(0.15),
            Self::SfmPoint => None,
        }
    }
}

/// One LiDAR return, or what stands in for one, on its exact sub-pixel position in a view.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DepthReturn {
    /// Continuous pixel position; the centre of the top left pixel is (0.5, 0.5).
    pub pixel: [f32; 2],
    /// Euclidean distance from the camera centre in metres (not camera z).
    pub range_m: f32,
    pub source: DepthSource,
    /// Weight of its loss relative to that of a LiDAR return.
    pub weight: f32,
}

impl DepthReturn {
    /// A LiDAR return, of weight 1.
    pub fn lidar(pixel: [f32; 2], range_m: f32) -> Self {
        Self {
            pixel,
            range_m,
            source: DepthSource::Lidar,
            weight: 1.0,
        }
    }
}

/// Which part of the data a view belongs to. Held-out views never reach a training step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Split {
    Train,
    HeldOut,
}

/// A posed image with labels and depths, in the local frame of the field to be trained.
///
/// For a background the local frame is the log's anchor frame (x forward, y left, z up); for an object it is the frame of its
/// cuboid at the frame's time (origin at the cuboid's centre, x forward, y left, z up).
#[derive(Clone, Debug)]
pub struct TrainView {
    /// The data set's frame index, for messages and reports.
    pub frame_index: u32,
    pub camera: Camera,
    pub local_from_camera: Rigid,
    /// sRGB, row-major, `height * width * 3` bytes.
    pub rgb: Vec<u8>,
    /// Row-major, `height * width`.
    pub labels: Vec<PixelLabel>,
    pub depth: Vec<DepthReturn>,
    pub split: Split,
}

impl TrainView {
    /// The ray through a continuous pixel position, in the local frame.
    pub fn ray(&self, pixel: DVec2) -> Ray {
        let direction = self
            .local_from_camera
            .direction(self.camera.direction(pixel));
        Ray {
            origin: self.local_from_camera.translation_m.as_vec3(),
            direction: direction.as_vec3(),
        }
    }

    /// The ray through the centre of pixel number `at`, row by row.
    pub fn pixel_ray(&self, at: usize) -> Ray {
        self.ray(self.camera.pixel_centre(at))
    }
}
