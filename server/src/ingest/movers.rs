//! Which tracks move in the world, and which are seen at all.

use backlot_engine::camera::Rigid;
use glam::DVec3;

use super::hull::{bounds, cuboid_hull};
use crate::domain::drive_log::{CameraFrame, DriveLog, Track};

/// A vehicle whose centre strays less than this is parked: annotations of parked cars wander by decimetres.
const VEHICLE_MOVES_M: f64 = 1.0;
/// People are annotated more tightly and move less.
const OTHER_MOVES_M: f64 = 0.5;
/// States averaged before displacement is measured, against single outliers.
const SMOOTHED_STATES: usize = 5;

/// Whether the track's cuboid moves in the world. A car that waits and then drives off is a mover in all its frames.
pub(super) fn is_moving(track: &Track) -> bool {
    let centres: Vec<DVec3> = smoothed(track);
    let Some(&first) = centres.first() else {
        return false;
    };
    let limit_m = if track.class.is_vehicle() {
        VEHICLE_MOVES_M
    } else {
        OTHER_MOVES_M
    };
    let farthest = centres
        .iter()
        .map(|c| c.distance(first))
        .fold(0.0, f64::max);
    farthest > limit_m
}

fn smoothed(track: &Track) -> Vec<DVec3> {
    let centre = |i: usize| track.states[i].world_from_cuboid.translation_m;
    let window = SMOOTHED_STATES.min(track.states.len());
    (0..(track.states.len() + 1).saturating_sub(window.max(1)))
        .map(|start| (start..start + window).map(centre).sum::<DVec3>() / window as f64)
        .collect()
}

/// Camera from cuboid at the frame's time; `None` where the track or the ego pose is unknown.
pub(super) fn camera_from_cuboid(
    log: &DriveLog,
    frame: &CameraFrame,
    track: &Track,
) -> Option<Rigid> {
    let world_from_camera = log.world_from_camera(frame)?;
    Some(world_from_camera.inverse() * track.at(frame.timestamp_ns)?)
}

/// Whether the track's cuboid projects into any image.
pub(super) fn is_in_any_frame(log: &DriveLog, track: &Track) -> bool {
    log.frames.iter().any(|frame| {
        let Some(camera) = log.camera(&frame.camera_id) else {
            return false;
        };
        let camera = &camera.camera;
        let hull = camera_from_cuboid(log, frame, track)
            .map(|pose| cuboid_hull(camera, &pose, track.size_m))
            .unwrap_or_default();
        bounds(&hull).is_some_and(|(lo, hi)| {
            let (width, height) = (f64::from(camera.width), f64::from(camera.height));
            hi.x > 0.0 && hi.y > 0.0 && lo.x < width && lo.y < height
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::domain::drive_log::{Occlusion, TrackState};
    use backlot_engine::class::ObjectClass;

    fn track(class: ObjectClass, x_m: impl Fn(usize) -> f64) -> Track {
        let state = |i: usize| TrackState {
            timestamp_ns: i as i64 * 100_000_000,
            world_from_cuboid: Rigid::from_heading(0.0, DVec3::new(x_m(i), 0.0, 0.0)),
            occlusion: Occlusion::None,
            truncation: 0.0,
        };
        Track {
            track_id: "7".into(),
            class,
            source_class: "Car".into(),
            size_m: DVec3::new(4.0, 1.8, 1.5),
            states: (0..20).map(state).collect(),
        }
    }

    #[test]
    fn parked_cars_with_wandering_annotations_are_not_movers() {
        let wander = |i: usize| 0.3 * (i as f64 * 1.7).sin() + if i == 9 { 2.0 } else { 0.0 };
        assert!(!is_moving(&track(ObjectClass::Car, wander)));
    }

    #[test]
    fn movers_are_found_even_if_they_wait_first() {
        let starts = |i: usize| if i < 14 { 0.0 } else { (i - 14) as f64 };
        assert!(is_moving(&track(ObjectClass::Car, starts)));
        let walks = |i: usize| 0.05 * i as f64;
        assert!(is_moving(&track(ObjectClass::Pedestrian, walks)));
        assert!(!is_moving(&track(ObjectClass::Car, walks)));
    }
}
