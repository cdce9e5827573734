//! Whether a place of the background was ever seen by the recording cameras past the movers.

use glam::DVec3;

use super::density::DensityField;
use super::hull::entry_m;
use super::recording::{RecordedFrame, Recording};
use crate::camera::{Camera, Rigid};

/// Training left out what lies in a mover's cuboid grown by this.
const MASK_MARGIN_M: f64 = 0.2;
/// It left out the ground around the footprint as well.
const CONTACT_MARGIN_M: f64 = 0.4;
const CONTACT_HEIGHT_M: f64 = 0.1;
/// One view is a mask's edge or a lucky gap; two have to agree.
const MIN_VIEWS: usize = 2;
/// Slack for the surface itself when asking what hides it: metres, and metres per metre for grazing rays.
const SURFACE_SLACK_M: (f64, f64) = (0.3, 0.06);

/// What the recording's frames saw.
pub(super) struct Sight<'a> {
    field: &'a dyn DensityField,
    views: Vec<View<'a>>,
    sun: Option<DVec3>,
}

/// One recorded image and the movers that were masked out of it.
struct View<'a> {
    camera: &'a Camera,
    frame: &'a RecordedFrame,
    movers: Vec<(Rigid, DVec3)>,
}

impl<'a> Sight<'a> {
    pub(super) fn new(field: &'a dyn DensityField, recording: &'a Recording) -> Self {
        let view = |(index, frame): (usize, &'a RecordedFrame)| {
            let movers = recording.tracks_at(index).filter(|(_, t, _)| t.moving);
            Some(View {
                camera: recording.camera(&frame.camera_id)?,
                frame,
                movers: movers.map(|(_, t, pose)| (pose, t.size_m)).collect(),
            })
        };
        let frames = recording.frames.iter().enumerate();
        Self {
            field,
            views: frames.filter_map(view).collect(),
            sun: recording.sun_direction_local,
        }
    }

    /// Whether at least two frames saw the local point `p` with neither a mover nor the background before it.
    pub(super) fn saw(&self, p: DVec3) -> bool {
        let mut seen = 0;
        self.views.iter().any(|view| {
            seen += usize::from(self.sees(view, p));
            seen >= MIN_VIEWS
        })
    }

    fn sees(&self, view: &View<'_>, p: DVec3) -> bool {
        let local_from_camera = &view.frame.local_from_camera;
        let in_camera = local_from_camera.inverse().point(p);
        let Some(pixel) = view.camera.project(in_camera) else {
            return false;
        };
        let (width, height) = (f64::from(view.camera.width), f64::from(view.camera.height));
        if !((0.0..width).contains(&pixel.x) && (0.0..height).contains(&pixel.y)) {
            return false;
        }
        let eye = local_from_camera.translation_m;
        let range = (p - eye).length();
        let direction = (p - eye) / range;
        let masked = |(pose, size_m): &(Rigid, DVec3)| self.masks(pose, *size_m, eye, direction, p);
        if view.movers.iter().any(masked) {
            return false;
        }
        let (slack_m, grazing) = SURFACE_SLACK_M;
        let reach = range - slack_m - grazing * range;
        reach <= 0.0 || self.field.hit(eye, direction, reach).is_none()
    }

    /// Whether training left out the pixel through which `eye` sees `p`, on account of one mover.
    fn masks(&self, pose: &Rigid, size_m: DVec3, eye: DVec3, direction: DVec3, p: DVec3) -> bool {
        let crosses = |box_pose: &Rigid, size_m: DVec3, from: DVec3, direction: DVec3| {
            entry_m(&box_pose.inverse(), size_m, from, direction).is_some()
        };
        let grown_m = size_m + DVec3::splat(2.0 * MASK_MARGIN_M);
        let bottom = pose.point(DVec3::Z * (-0.5 * size_m.z));
        let contact = Rigid::new(pose.rotation, bottom);
        let around = 2.0 * CONTACT_MARGIN_M;
        let slab_m = DVec3::new(size_m.x + around, size_m.y + around, CONTACT_HEIGHT_M);
        crosses(pose, grown_m, eye, direction)
            || crosses(&contact, slab_m, eye, direction)
            || self.sun.is_some_and(|sun| crosses(pose, size_m, p, sun))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::box_world::{BoxWorld, drive, street_car};

    fn world(boxes: Vec<(DVec3, DVec3)>) -> BoxWorld {
        BoxWorld {
            slope: 0.0,
            boxes,
            half_width: 10.0,
            length: 80.0,
        }
    }

    /// A car that keeps its distance of `ahead_m` before the camera.
    fn led(ahead_m: f64, moving: bool) -> Recording {
        let mut recording = drive(0.0, 12, 0.5);
        let mut track = street_car(&recording, "lead", DVec3::ZERO, moving);
        for (pose, frame) in track.local_from_cuboid.iter_mut().zip(&recording.frames) {
            let x = frame.local_from_ego.translation_m.x + ahead_m;
            *pose = Some(Rigid::from_heading(0.0, DVec3::new(x, 0.0, 0.75)));
        }
        recording.tracks.push(track);
        recording
    }

    #[test]
    fn what_a_mover_hides_in_every_frame_was_not_seen() {
        let (world, recording) = (world(Vec::new()), led(9.0, true));
        let sight = Sight::new(&world, &recording);
        // Behind the lead car all the time; before it once the drive went on; beside it.
        assert!(!sight.saw(DVec3::new(22.0, 0.0, 0.0)));
        assert!(sight.saw(DVec3::new(10.5, 0.0, 0.0)));
        assert!(sight.saw(DVec3::new(22.0, 5.0, 0.0)));
        // A parked car is part of the background and masks nothing.
        let parked = led(9.0, false);
        assert!(Sight::new(&world, &parked).saw(DVec3::new(22.0, 0.0, 0.0)));
    }

    #[test]
    fn behind_a_wall_nothing_was_seen() {
        let wall = (DVec3::new(14.0, 3.0, 0.0), DVec3::new(15.0, 8.0, 4.0));
        let (walled, recording) = (world(vec![wall]), led(9.0, true));
        let p = DVec3::new(24.0, 6.5, 0.0);
        assert!(!Sight::new(&walled, &recording).saw(p));
        assert!(Sight::new(&world(Vec::new()), &recording).saw(p));
        assert!(Sight::new(&walled, &recording).saw(DVec3::new(14.0, 5.0, 1.0)));
    }

    #[test]
    fn the_shadow_of_a_mover_was_left_out_where_the_sun_is_known() {
        let (world, mut recording) = (world(Vec::new()), led(9.0, true));
        // Frame by frame the shadow lies 1.5 m beside the car, on the same strip of road.
        let p = DVec3::new(11.0, -1.9, 0.0);
        assert!(Sight::new(&world, &recording).saw(p));
        recording.frames.truncate(4);
        recording.tracks[0].local_from_cuboid.truncate(4);
        assert!(Sight::new(&world, &recording).saw(p));
        recording.sun_direction_local = Some(DVec3::new(0.0, 1.0, 1.0).normalize());
        assert!(!Sight::new(&world, &recording).saw(p));
    }
}
