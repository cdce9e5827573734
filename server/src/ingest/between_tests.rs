//! A scanner that turns four times as often as the camera records.

use std::collections::BTreeSet;

use backlot_engine::train::BackgroundInput;
use glam::{DVec2, DVec3};

use super::decompose_tests::street;
use super::{LogLabels, background_set};
use crate::domain::drive_log::DriveLog;

/// The ego drives this far from one sweep to the next.
const SWEEP_M: f64 = 0.3;

/// Frames 0, 4 and 8 of the street, of which 4 is held out, with some of its twelve sweeps.
fn background(is_recorded: impl Fn(usize) -> bool) -> (DriveLog, BackgroundInput) {
    let (mut log, blobs) = street(true);
    log.frames.retain(|f| f.frame_index % 4 == 0);
    let mut number = 0..;
    log.sweeps
        .retain(|_| number.next().is_some_and(&is_recorded));
    let set = background_set(&log, &blobs, &LogLabels::default(), 2, 800, |_, _| true);
    let input = set.unwrap().unwrap().input;
    (log, input)
}

/// Numbers of the sweeps whose pulses were taken, each with the frame whose pose corrections apply.
fn sweeps_of(input: &BackgroundInput) -> BTreeSet<(u32, u32)> {
    let beams = input.beams.iter().map(|beam| {
        let number = f64::from(beam.origin_m[0]) / SWEEP_M;
        assert!((number - number.round()).abs() < 1e-4, "{number}");
        let view = &input.views[beam.view as usize];
        (number.round() as u32, view.frame_index)
    });
    beams.collect()
}

#[test]
fn sweeps_between_frames_are_taken_half_a_metre_apart_and_held_out_ones_never() {
    let (_, input) = background(|_| true);
    // Every other one is 0.3 m from a frame's.
    let expected = [(0, 0), (2, 0), (6, 8), (8, 8), (10, 8)];
    assert_eq!(sweeps_of(&input), BTreeSet::from(expected));
    let (_, input) = background(|i| i % 4 == 0);
    assert_eq!(sweeps_of(&input), BTreeSet::from([(0, 0), (8, 8)]));
}

#[test]
fn their_returns_seed_the_static_scene_and_nothing_else() {
    // Of the frames' own there is none, nor any near enough in time to stand for it.
    let (log, between) = background(|i| i % 4 == 2);
    assert!(between.views.iter().all(|view| view.depth.is_empty()));
    assert!(between.lidar_points.len() > 1000);
    let near_driver = |p: &&[f32; 3]| p[1] < -1.7 && p[1] > -3.3 && p[2] > 0.3 && p[0] < 30.0;
    assert_eq!(between.lidar_points.iter().find(near_driver), None);
    // Half of its face is hidden behind the parked car in every frame.
    let hidden = |p: &&[f32; 3]| (p[0] - 18.0).abs() < 0.01 && (5.2..6.8).contains(&p[1]);
    assert!(between.lidar_points.iter().filter(hidden).count() > 100);
    let camera = &log.cameras[0];
    let size = DVec2::new(camera.camera.width.into(), camera.camera.height.into());
    for p in &between.lidar_points {
        let in_image = [0.0, 8.0].iter().any(|sweep| {
            let ego_m = DVec3::from(p.map(f64::from)) - DVec3::X * SWEEP_M * sweep;
            let pixel = camera.ego_from_camera.inverse().point(ego_m);
            let pixel = camera.camera.project(pixel);
            pixel.is_some_and(|p| p.cmpge(-DVec2::ONE).all() && p.cmple(size + 1.0).all())
        });
        assert!(in_image, "{p:?}");
    }
}
