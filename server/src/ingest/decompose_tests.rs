//! A street of painted boxes: a parked car, a driving one in the next lane, and a third half hidden by the parked one.

use std::collections::BTreeMap;
use std::convert::Infallible;
use std::io::Cursor;

use ::image::{DynamicImage, ImageBuffer, ImageFormat, Luma, RgbImage};
use backlot_engine::camera::{Camera, Distortion, Rigid};
use backlot_engine::class::ObjectClass;
use backlot_engine::view::{PixelLabel, Split, TrainView};
use bytes::Bytes;
use glam::{DQuat, DVec2, DVec3};

use super::hull::{cuboid_hull, raster};
use super::movers::camera_from_cuboid;
use super::object_plan::Rejection;
use super::{
    LogBlobs, LogLabels, LogMasks, MaskMatching, MatchedMasks, background_set, match_masks,
    object_set, plan_objects, recording,
};
use crate::domain::blob::{BlobRef, Digest};
use crate::domain::drive_log::{
    CameraFrame, DriveLog, LidarSweep, LogCamera, MANIFEST_VERSION, Occlusion, PointFormat,
    TimedPose, Track, TrackState, Trajectory,
};

const FRAMES: usize = 12;
const FRAME_NS: i64 = 100_000_000;
const PARKED: usize = 0;
const DRIVING: usize = 1;
const HIDDEN: usize = 2;

#[derive(Default)]
pub(super) struct Blobs(BTreeMap<Digest, Bytes>);

impl LogBlobs for Blobs {
    type Error = Infallible;

    fn size_bytes(&self, blob: &BlobRef) -> Result<Option<u64>, Infallible> {
        Ok(self.0.get(&blob.digest).map(|b| b.len() as u64))
    }

    fn read(&self, blob: &BlobRef) -> Result<Bytes, Infallible> {
        Ok(self.0[&blob.digest].clone())
    }
}

impl Blobs {
    pub(super) fn add(&mut self, content: Vec<u8>) -> BlobRef {
        let blob = BlobRef::of(&content);
        self.0.insert(blob.digest, content.into());
        blob
    }

    pub(super) fn content(&self, blob: &BlobRef) -> Bytes {
        self.0[&blob.digest].clone()
    }

    fn add_png(&mut self, image: impl Into<DynamicImage>) -> BlobRef {
        let mut bytes = Cursor::new(Vec::new());
        image.into().write_to(&mut bytes, ImageFormat::Png).unwrap();
        self.add(bytes.into_inner())
    }
}

fn track(track_id: &str, start_m: DVec3, speed_m: f64) -> Track {
    let state = |i: usize| TrackState {
        timestamp_ns: i as i64 * FRAME_NS,
        world_from_cuboid: Rigid::from_heading(0.0, start_m + DVec3::X * speed_m * i as f64),
        occlusion: Occlusion::Unknown,
        truncation: -1.0,
    };
    Track {
        track_id: track_id.into(),
        class: ObjectClass::Car,
        source_class: "Car".into(),
        size_m: DVec3::new(4.0, 1.8, 1.5),
        states: (0..FRAMES).map(state).collect(),
    }
}

/// The ego drives 0.3 m a frame; `with_masks` decides whether the log has instance masks.
pub(super) fn street(with_masks: bool) -> (DriveLog, Blobs) {
    let camera = LogCamera {
        camera_id: "front".into(),
        camera: Camera {
            width: 320,
            height: 160,
            focal_px: DVec2::splat(280.0),
            principal_px: DVec2::new(160.0, 70.0),
            distortion: Distortion::None,
        },
        ego_from_camera: Rigid::new(
            DQuat::from_xyzw(-0.5, 0.5, -0.5, 0.5),
            DVec3::new(0.0, 0.0, 1.5),
        ),
    };
    let ego = (0..FRAMES).map(|i| TimedPose {
        timestamp_ns: i as i64 * FRAME_NS,
        pose: Rigid::from_heading(0.0, DVec3::X * 0.3 * i as f64),
    });
    let mut log = DriveLog {
        version: MANIFEST_VERSION,
        id: "driveLogs/boxes".parse().unwrap(),
        dataset: "test".into(),
        synthetic: true,
        local_from_world: Rigid::IDENTITY,
        cameras: vec![camera],
        world_from_ego: Trajectory::new(ego.collect()),
        frames: Vec::new(),
        sweeps: Vec::new(),
        sfm_points: None,
        tracks: vec![
            track("parked", DVec3::new(14.0, 3.0, 0.75), 0.0),
            track("driving", DVec3::new(11.0, -2.5, 0.75), 0.8),
            track("hidden", DVec3::new(20.0, 6.0, 0.75), 0.0),
        ],
        notes: Vec::new(),
        sun_direction_world: Some(DVec3::new(0.0, 0.6, 0.8)),
    };
    let mut blobs = Blobs::default();
    for i in 0..FRAMES {
        let frame = frame(&log, i, with_masks, &mut blobs);
        log.frames.push(frame);
        log.sweeps.push(sweep(&log, i, &mut blobs));
    }
    (log, blobs)
}

fn frame(log: &DriveLog, i: usize, with_masks: bool, blobs: &mut Blobs) -> CameraFrame {
    let mut frame = CameraFrame {
        camera_id: "front".into(),
        frame_index: i as u32,
        timestamp_ns: i as i64 * FRAME_NS,
        exposure_ns: 0,
        readout_ns: 0,
        readout_direction: Default::default(),
        image: BlobRef::of(&[]),
        instance_mask: None,
        sky_mask: None,
        depth_map: None,
        free_instance_mask: None,
    };
    let camera = &log.cameras[0].camera;
    let mut rgb = RgbImage::from_pixel(camera.width, camera.height, ::image::Rgb([80; 3]));
    let mut mask: ImageBuffer<Luma<u16>, Vec<u16>> = ImageBuffer::new(camera.width, camera.height);
    // Farthest first, so that nearer boxes cover it.
    for index in [HIDDEN, PARKED, DRIVING] {
        let track = &log.tracks[index];
        let pose = camera_from_cuboid(log, &frame, track).unwrap();
        let hull = cuboid_hull(camera, &pose, track.size_m);
        raster(&hull, camera.width, camera.height, |row, columns| {
            for x in columns {
                rgb.put_pixel(
                    x as u32,
                    row as u32,
                    ::image::Rgb([60 * index as u8, 200, 40]),
                );
                mask.put_pixel(x as u32, row as u32, Luma([index as u16 + 1]));
            }
        });
    }
    frame.image = blobs.add_png(rgb);
    frame.instance_mask = with_masks.then(|| blobs.add_png(mask));
    frame
}

/// Returns on the faces that look at the ego, a wall far behind, and the ground.
fn sweep(log: &DriveLog, i: usize, blobs: &mut Blobs) -> LidarSweep {
    let timestamp_ns = i as i64 * FRAME_NS;
    let lidar = DVec3::new(0.3 * i as f64, 0.0, 1.7);
    let mut points: Vec<DVec3> = Vec::new();
    for track in &log.tracks {
        let pose = track.at(timestamp_ns).unwrap();
        for (u, v) in grid(20, 12) {
            let face = DVec3::new(-0.5, u - 0.5, 0.1 - 0.5 + 0.88 * v) * track.size_m;
            points.push(pose.point(face));
        }
    }
    points.extend(grid(80, 20).map(|(u, v)| DVec3::new(40.0, 40.0 * (u - 0.5), 8.0 * v)));
    points.extend(grid(60, 30).map(|(u, v)| DVec3::new(5.0 + 30.0 * v, 16.0 * (u - 0.5), 0.0)));
    let bytes = points.iter().flat_map(|p| {
        let p = (*p - lidar).as_vec3();
        [p.x, p.y, p.z, 0.5].map(f32::to_le_bytes).concat()
    });
    LidarSweep {
        lidar_id: "top".into(),
        timestamp_ns,
        ego_from_lidar: Rigid::new(DQuat::IDENTITY, DVec3::Z * 1.7),
        points: blobs.add(bytes.collect()),
        format: PointFormat::XyziF32,
    }
}

fn grid(columns: usize, rows: usize) -> impl Iterator<Item = (f64, f64)> {
    (0..columns * rows).map(move |i| {
        let (x, y) = (i % columns, i / columns);
        (
            (x as f64 + 0.5) / columns as f64,
            (y as f64 + 0.5) / rows as f64,
        )
    })
}

fn label_at(log: &DriveLog, view: &TrainView, world_m: DVec3) -> PixelLabel {
    let camera_m = view.local_from_camera.inverse().point(world_m);
    let pixel = view.camera.project(camera_m).unwrap();
    assert!(log.local_from_world == Rigid::IDENTITY);
    view.labels[pixel.y as usize * view.camera.width as usize + pixel.x as usize]
}

#[test]
fn backgrounds_lose_movers_with_their_shadows_and_keep_parked_cars() {
    for with_masks in [true, false] {
        let (log, blobs) = street(with_masks);
        let set = background_set(&log, &blobs, &LogLabels::default(), 8, 800, |_, _| true);
        let input = set.unwrap().unwrap().input;
        assert_eq!(input.views.len(), FRAMES);
        let held: Vec<u32> = input
            .views
            .iter()
            .filter(|v| v.split == Split::HeldOut)
            .map(|v| v.frame_index)
            .collect();
        assert_eq!(held, [4]);
        for view in &input.views {
            let ns = i64::from(view.frame_index) * FRAME_NS;
            let driving = log.tracks[DRIVING].at(ns).unwrap();
            let parked = log.tracks[PARKED].at(ns).unwrap();
            let on_driving = driving.point(DVec3::new(-2.0, 0.0, 0.0));
            // The sun stands on the left: the shadow falls to the right, 1.1 m beyond the box.
            let in_shadow = driving.point(DVec3::new(0.0, -1.6, -0.75));
            let on_road = driving.point(DVec3::new(0.0, -4.0, -0.75));
            let on_parked = parked.point(DVec3::new(-2.0, 0.0, 0.0));
            assert_eq!(label_at(&log, view, on_driving), PixelLabel::Unknown);
            assert_eq!(label_at(&log, view, in_shadow), PixelLabel::Unknown);
            assert_eq!(label_at(&log, view, on_road), PixelLabel::Foreground);
            assert_eq!(label_at(&log, view, on_parked), PixelLabel::Foreground);
        }
        let near_driver = |p: &[f32; 3]| p[1] < -1.7 && p[1] > -3.3 && p[2] > 0.3 && p[0] < 30.0;
        assert!(!input.lidar_points.iter().any(near_driver));
        let on_parked = |p: &[f32; 3]| (p[0] - 12.0).abs() < 0.01 && p[2] > 0.3;
        assert!(input.lidar_points.iter().any(on_parked));
    }
}

#[test]
fn depth_is_metric_and_nothing_hidden_is_kept() {
    let (log, blobs) = street(true);
    let set = background_set(&log, &blobs, &LogLabels::default(), 8, 800, |_, _| true);
    for view in &set.unwrap().unwrap().input.views {
        assert!(view.depth.len() > 500);
        let mut on_scene = 0;
        for depth in &view.depth {
            let pixel = DVec2::new(depth.pixel[0].into(), depth.pixel[1].into());
            let ray = view.camera.direction(pixel) * f64::from(depth.range_m);
            let p = view.local_from_camera.point(ray);
            let surface = p.z.abs() < 0.01 || (p.x - 40.0).abs() < 0.01 || p.z > 0.07;
            assert!(surface, "{p}");
            let at = pixel.y as usize * view.camera.width as usize + pixel.x as usize;
            on_scene += usize::from(view.labels[at] == PixelLabel::Foreground);
        }
        // Rounding to f32 may move a return across a pixel's edge, next to a mover.
        assert!(on_scene * 100 >= view.depth.len() * 99);
    }
}

#[test]
fn beams_come_from_every_sweep_but_those_of_held_out_frames() {
    let (log, blobs) = street(true);
    let set = background_set(&log, &blobs, &LogLabels::default(), 8, 800, |_, _| true);
    let input = set.unwrap().unwrap().input;
    // Ground close before the sensor is within its blind zone.
    let far_returns = |frame: u32| {
        let points = blobs.0[&log.sweeps[frame as usize].points.digest].chunks_exact(16);
        let ranges = points.map(|point| {
            let axis = |i: usize| f32::from_le_bytes(point[4 * i..4 * i + 4].try_into().unwrap());
            DVec3::new(axis(0).into(), axis(1).into(), axis(2).into()).length()
        });
        ranges.filter(|range_m| *range_m >= 3.0).count()
    };
    let mut by_view = vec![0; input.views.len()];
    for beam in &input.beams {
        let view = &input.views[beam.view as usize];
        let lidar = DVec3::new(0.3 * f64::from(view.frame_index), 0.0, 1.7);
        assert!(DVec3::from(beam.origin_m.map(f64::from)).distance(lidar) < 1e-5);
        let range_m = DVec3::from(beam.return_m.map(f64::from)).distance(lidar);
        assert!(range_m >= 3.0, "{range_m}");
        by_view[beam.view as usize] += 1;
    }
    for (count, view) in by_view.into_iter().zip(&input.views) {
        match view.split {
            Split::Train => assert_eq!(count, far_returns(view.frame_index)),
            Split::HeldOut => assert_eq!(count, 0),
        }
    }
}

#[test]
fn usable_tracks_are_planned_and_the_hidden_one_is_rejected_by_reason() {
    let (log, _) = street(true);
    let plans = plan_objects(&log);
    let plan = |track: usize| plans.iter().find(|p| p.track == track).unwrap();
    assert_eq!(plan(PARKED).frames.len(), FRAMES);
    assert!(!plan(PARKED).moving && plan(DRIVING).moving);
    assert!(plan(DRIVING).frames.len() >= 8);
    let hidden = plan(HIDDEN);
    assert!(hidden.frames.len() < FRAMES);
    assert!(hidden.rejected[&Rejection::Occluded] > 0);
    assert!(plans[0].area_px >= plans[1].area_px);
}

#[test]
fn object_views_are_crops_in_the_cuboids_frame() {
    for with_masks in [true, false] {
        let (log, blobs) = street(with_masks);
        for track in [PARKED, DRIVING] {
            let plans = plan_objects(&log);
            let plan = plans.iter().find(|p| p.track == track).unwrap();
            let set = object_set(&log, &blobs, &LogLabels::default(), plan, 8, |_, _| true);
            let input = set.unwrap().unwrap().input;
            assert!(input.symmetric && !input.lidar_points.is_empty());
            // Every return lies on the rear face, whether the car moved or not.
            assert!(input.lidar_points.iter().all(|p| (p[0] + 2.0).abs() < 0.01));
            for view in &input.views {
                assert!(view.camera.width < 200);
                let label = |p: DVec3| label_at(&log, view, p);
                assert_eq!(label(DVec3::new(-2.0, 0.0, 0.1)), PixelLabel::Foreground);
                assert_eq!(label(DVec3::new(0.0, 0.0, 1.0)), PixelLabel::Background);
                for depth in &view.depth {
                    let pixel = DVec2::new(depth.pixel[0].into(), depth.pixel[1].into());
                    let ray = view.camera.direction(pixel) * f64::from(depth.range_m);
                    let p = view.local_from_camera.point(ray);
                    assert!((p.x + 2.0).abs() < 0.01, "{p}");
                }
            }
        }
    }
}

/// How often each label lies on the pixels painted as `track`.
fn labels_on(view: &TrainView, track: usize) -> BTreeMap<u8, usize> {
    let mut counts = BTreeMap::new();
    for (label, rgb) in view.labels.iter().zip(view.rgb.chunks_exact(3)) {
        if rgb == [60 * track as u8, 200, 40] {
            *counts.entry(*label as u8).or_default() += 1;
        }
    }
    counts
}

#[test]
fn a_nearer_instance_is_unknown_and_a_farther_one_is_background() {
    let (log, blobs) = street(true);
    let plans = plan_objects(&log);
    let views = |track: usize| {
        let plan = plans.iter().find(|p| p.track == track).unwrap();
        let set = object_set(&log, &blobs, &LogLabels::default(), plan, 8, |_, _| true).unwrap();
        set.unwrap().input.views
    };
    let mut farther = 0;
    for view in views(PARKED) {
        let counts = labels_on(&view, HIDDEN);
        let background = counts.get(&(PixelLabel::Background as u8));
        farther += background.copied().unwrap_or(0);
        assert!(!counts.contains_key(&(PixelLabel::Foreground as u8)));
    }
    assert!(farther > 100, "{farther}");
    for view in views(HIDDEN) {
        let counts = labels_on(&view, PARKED);
        let unknown = counts.get(&(PixelLabel::Unknown as u8));
        assert_eq!(
            unknown.copied().unwrap_or(0),
            counts.values().sum::<usize>()
        );
    }
}

#[test]
fn stopping_and_the_recording() {
    let (log, blobs) = street(true);
    assert!(
        background_set(&log, &blobs, &LogLabels::default(), 8, 800, |done, _| done
            < 3)
        .unwrap()
        .is_none()
    );
    let recording = recording(&log, &[]);
    recording.validate().unwrap();
    assert_eq!(recording.frames.len(), FRAMES);
    let moving: Vec<bool> = recording.tracks.iter().map(|t| t.moving).collect();
    assert_eq!(moving, [false, true, false]);
}

/// Replaces the masks of a street by ones that name no track: values that change from frame to frame.
pub(super) fn untie(log: &mut DriveLog, blobs: &mut Blobs) {
    for (i, frame) in log.frames.iter_mut().enumerate() {
        let tied = blobs.0[&frame.instance_mask.take().unwrap().digest].clone();
        let tied = ::image::load_from_memory(&tied).unwrap().into_luma16();
        let free = ImageBuffer::from_fn(tied.width(), tied.height(), |x, y| {
            let value = tied.get_pixel(x, y).0[0];
            let other = 7_000 + 100 * i as u16 + (value * 37) % 11;
            Luma([if value == 0 { 0 } else { other }])
        });
        frame.free_instance_mask = Some(blobs.add_png(free));
    }
}

/// Without sweeps: the street's scanner sees through cars.
pub(super) fn matched(log: &DriveLog, blobs: &Blobs) -> MatchedMasks {
    let matching = MaskMatching::default();
    let log = DriveLog {
        sweeps: Vec::new(),
        ..log.clone()
    };
    let masks = match_masks(&log, blobs, &LogMasks(blobs), &matching, |_, _| true);
    masks.unwrap().unwrap()
}

#[test]
fn matched_masks_label_like_masks_that_name_their_tracks() {
    let (log, blobs) = street(true);
    let (mut free_log, mut free_blobs) = street(true);
    untie(&mut free_log, &mut free_blobs);
    let labels = LogLabels::Made(matched(&free_log, &free_blobs));
    let plans = plan_objects(&log);
    for track in [PARKED, DRIVING] {
        let plan = plans.iter().find(|p| p.track == track).unwrap();
        let tied = object_set(&log, &blobs, &LogLabels::default(), plan, 8, |_, _| true);
        let free = object_set(&free_log, &free_blobs, &labels, plan, 8, |_, _| true);
        let (tied, free) = (tied.unwrap().unwrap(), free.unwrap().unwrap());
        assert_eq!(free.usable_frames, tied.usable_frames);
        for (free, tied) in free.input.views.iter().zip(&tied.input.views) {
            assert_eq!(labels_on(free, track), labels_on(tied, track));
        }
    }
    // Masks that were never matched are no one's.
    let unmatched = LogLabels::default();
    let plan = plans.iter().find(|p| p.track == PARKED).unwrap();
    let none = object_set(&free_log, &free_blobs, &unmatched, plan, 8, |_, _| true);
    assert_eq!(none.unwrap().unwrap().usable_frames, 0);
}
