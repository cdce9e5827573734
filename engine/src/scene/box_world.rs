//! An analytic street for tests: a sloped ground and solid boxes, with exact rays.

use glam::{DVec2, DVec3};

use super::density::DensityField;
use super::recording::{RecordedCamera, RecordedFrame, RecordedTrack, Recording};
use super::solid_field::stepped_field;
use crate::camera::{Camera, Distortion, Rigid};
use crate::class::ObjectClass;
use crate::field::Field;

pub(super) const SOLID_SIGMA: f64 = 100.0;

pub(super) struct BoxWorld {
    /// Rise per metre along x.
    pub(super) slope: f64,
    /// Solid boxes as (low, high), heights above the local ground.
    pub(super) boxes: Vec<(DVec3, DVec3)>,
    /// The ground exists within |y| of this.
    pub(super) half_width: f64,
    pub(super) length: f64,
}

impl BoxWorld {
    pub(super) fn ground(&self, x: f64) -> f64 {
        self.slope * x
    }

    /// Distance to the first solid surface: by small steps refined by bisection, so that it shares nothing with the code it tests.
    pub(super) fn trace(&self, origin: DVec3, direction: DVec3, t_max: f64) -> Option<f64> {
        let step = 0.05;
        let solid = |t: f64| self.solid(origin + direction * t);
        let mut t = step;
        while t < t_max {
            if solid(t) {
                let (mut low, mut high) = (t - step, t);
                for _ in 0..20 {
                    let middle = 0.5 * (low + high);
                    if solid(middle) {
                        high = middle;
                    } else {
                        low = middle;
                    }
                }
                return Some(high);
            }
            t += step;
        }
        None
    }

    pub(super) fn solid(&self, p: DVec3) -> bool {
        let above = p.z - self.ground(p.x);
        let on_street = p.y.abs() <= self.half_width && (-2.0..self.length).contains(&p.x);
        let local = p.with_z(above);
        (on_street && (-0.5..0.0).contains(&above))
            || self
                .boxes
                .iter()
                .any(|(low, high)| local.cmpge(*low).all() && local.cmplt(*high).all())
    }

    /// Depth below the nearest surface in metres, negative outside; of the surface that is deepest or nearest.
    pub(super) fn depth(&self, p: DVec3) -> f64 {
        let above = p.z - self.ground(p.x);
        let local = p.with_z(above);
        let edges = (self.half_width - p.y.abs())
            .min(p.x + 2.0)
            .min(self.length - p.x);
        let slab = (-above).min(above + 0.5).min(edges);
        let boxes = self.boxes.iter();
        boxes
            .map(|(low, high)| (local - *low).min(*high - local).min_element())
            .fold(slab, f64::max)
    }

    /// The same world in voxels: raw density falls from a voxel inside each surface to a voxel outside, so that the surfaces
    /// between the nodes are where they were.
    pub(super) fn voxelised(&self, voxel_m: f32) -> Field {
        let (low, high) = self.voxel_bounds();
        let bounds = (low.as_vec3(), high.as_vec3());
        stepped_field(bounds, voxel_m, [0.4; 3], MARCH_STEP_M, |p| {
            let voxels = self.depth(p.as_dvec3()) as f32 / voxel_m;
            (RAW_PER_VOXEL * voxels.clamp(-1.0, 1.0)).exp().ln_1p() / voxel_m
        })
    }

    /// The box that [`Self::voxelised`] fills.
    pub(super) fn voxel_bounds(&self) -> (DVec3, DVec3) {
        let rise = self.slope * self.length;
        (
            DVec3::new(-4.0, -self.half_width, -1.5),
            DVec3::new(self.length, self.half_width, rise + 4.0),
        )
    }
}

/// So fine that a ray does not step over a corner.
const MARCH_STEP_M: f32 = 0.02;
/// Raw density a voxel below a surface; a voxel above it is empty to 1e-6.
pub(super) const RAW_PER_VOXEL: f32 = 15.0;

impl DensityField for BoxWorld {
    fn sigma(&self, p: DVec3) -> f64 {
        if self.solid(p) { SOLID_SIGMA } else { 0.0 }
    }

    fn hit(&self, origin: DVec3, direction: DVec3, t_max: f64) -> Option<f64> {
        self.trace(origin, direction, t_max)
    }

    fn bounds(&self) -> (DVec3, DVec3) {
        (
            DVec3::new(-5.0, -20.0, -5.0),
            DVec3::new(self.length + 5.0, 20.0, 15.0),
        )
    }
}

pub(super) fn camera() -> Camera {
    Camera {
        width: 640,
        height: 384,
        focal_px: DVec2::splat(400.0),
        principal_px: DVec2::new(320.0, 192.0),
        distortion: Distortion::None,
    }
}

/// OpenCV camera axes in a frame with x forward, y left, z up.
pub(super) fn forward_from_camera() -> glam::DQuat {
    glam::DQuat::from_mat3(&glam::DMat3::from_cols(-DVec3::Y, -DVec3::Z, DVec3::X))
}

/// A drive along x over a slope: `count` frames `spacing_m` apart, camera 1.6 m above the ground, ego frame on the ground.
pub(super) fn drive(slope: f64, count: u32, spacing_m: f64) -> Recording {
    let pitch = glam::DQuat::from_rotation_y(-libm::atan(slope));
    let frames = (0..count).map(|i| {
        let x = f64::from(i) * spacing_m;
        let local_from_ego = Rigid::new(pitch, DVec3::new(x, 0.0, slope * x));
        RecordedFrame {
            camera_id: "front".into(),
            frame_index: i,
            timestamp_ns: i64::from(i) * 100_000_000,
            local_from_camera: local_from_ego
                * Rigid::new(forward_from_camera(), DVec3::new(0.0, 0.0, 1.6)),
            local_from_ego,
            image: None,
            instance_mask: None,
        }
    });
    Recording {
        cameras: vec![RecordedCamera {
            camera_id: "front".into(),
            camera: camera(),
        }],
        frames: frames.collect(),
        tracks: Vec::new(),
        sun_direction_local: None,
        daylight: None,
    }
}

/// A car with a track in every frame at `centre`, level; `moving` only as a flag.
pub(super) fn street_car(
    recording: &Recording,
    track_id: &str,
    centre: DVec3,
    moving: bool,
) -> RecordedTrack {
    RecordedTrack {
        track_id: track_id.into(),
        class: ObjectClass::Car,
        size_m: DVec3::new(4.5, 2.0, 1.5),
        moving,
        local_from_cuboid: vec![Some(Rigid::from_heading(0.0, centre)); recording.frames.len()],
    }
}
