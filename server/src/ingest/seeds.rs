//! Where the log measured surfaces: points that seed a background's voxels.

use std::collections::HashSet;

use backlot_engine::camera::{Camera, Rigid};
use backlot_engine::view::Split;
use glam::{DVec2, DVec3};

use super::beams::NEAREST_M;
use super::lidar::WorldReturn;
use crate::domain::drive_log::DriveLog;

/// Points closer together than this seed the same voxels.
const POINT_SPACING_M: f64 = 0.05;

/// Points in the local frame, no two in one cell.
#[derive(Debug)]
pub(super) struct Seeds {
    /// Of the training frames: camera, and its frame from the local one.
    images: Vec<(Camera, Rigid)>,
    cells: HashSet<[i32; 3]>,
    pub(super) points: Vec<[f32; 3]>,
}

impl Seeds {
    /// `splits` has the split of every frame of the log.
    pub(super) fn new(log: &DriveLog, splits: &[Option<Split>]) -> Self {
        let frames = log.frames.iter().zip(splits);
        let train = frames.filter(|(_, split)| **split == Some(Split::Train));
        let images = train.filter_map(|(frame, _)| {
            let camera = log.camera(&frame.camera_id)?.camera;
            let local_from_camera = log.local_from_world * log.world_from_camera(frame)?;
            Some((camera, local_from_camera.inverse()))
        });
        Self {
            images: images.collect(),
            cells: HashSet::new(),
            points: Vec::new(),
        }
    }

    pub(super) fn add(&mut self, local_m: DVec3) {
        self.add_if(local_m, |_| true);
    }

    /// Adds a sweep's returns on the static scene that lie in some training image, hidden there or not: what a parked car hides is
    /// as solid as the rest. Space in no image need not be stored.
    pub(super) fn add_sweep(&mut self, log: &DriveLog, returns: &[WorldReturn], moving: &[bool]) {
        let is_static = |r: &&WorldReturn| r.owner.is_none_or(|owner| !moving[owner.track]);
        let far = |r: &&WorldReturn| r.world_m.distance(r.origin_m) >= NEAREST_M;
        for r in returns.iter().filter(is_static).filter(far) {
            let local_m = log.local_from_world.point(r.world_m);
            self.add_if(local_m, |images| images.iter().any(|i| is_in(i, local_m)));
        }
    }

    fn add_if(&mut self, local_m: DVec3, wanted: impl Fn(&[(Camera, Rigid)]) -> bool) {
        let cell = (local_m / POINT_SPACING_M).floor().as_ivec3().to_array();
        if self.cells.insert(cell) && wanted(&self.images) {
            self.points.push(local_m.as_vec3().to_array());
        }
    }
}

fn is_in((camera, camera_from_local): &(Camera, Rigid), local_m: DVec3) -> bool {
    let pixel = camera.project(camera_from_local.point(local_m));
    let size = DVec2::new(camera.width.into(), camera.height.into());
    pixel.is_some_and(|p| p.cmpge(DVec2::ZERO).all() && p.cmplt(size).all())
}
