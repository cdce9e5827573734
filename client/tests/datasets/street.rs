//! The generated log that is written in every form: two cameras, a tilted world far from its origin, JPEG images.

use std::io::Cursor;
use std::sync::OnceLock;

use backlot_client::generator::{LidarConfig, StreetConfig, StreetWorld};
use backlot_client::geometry::{rigid_from_wire, rigid_to_wire};
use backlot_client::motion::{ego_pose_at, track_pose_at};
use backlot_client::read_log::ReadLog;
use backlot_engine::camera::Rigid;
use backlot_proto::v1;
use glam::{DQuat, DVec3, EulerRot};

/// Columns of a whole turn of the scanner; its sector starts in the middle of one.
pub(crate) const TURN_COLUMNS: u32 = 360;
pub(crate) const BEAMS: u32 = 12;
const STEP_RAD: f64 = std::f64::consts::TAU / TURN_COLUMNS as f64;

/// The scanner's beams, lowest first.
pub(crate) fn elevations_rad() -> Vec<f64> {
    let lidar = config().lidar;
    let rise = (lidar.elevation_max_rad - lidar.elevation_min_rad) / f64::from(BEAMS - 1);
    (0..BEAMS)
        .map(|beam| lidar.elevation_min_rad + rise * f64::from(beam))
        .collect()
}

fn config() -> StreetConfig {
    StreetConfig {
        seed: 7,
        frames: 5,
        width: 96,
        height: 64,
        travel_m: 4.0,
        ego_speed_m_s: 8.0,
        parked_cars: 3,
        moving_cars: 2,
        supersample: 1,
        lidar: LidarConfig {
            beams: BEAMS,
            elevation_min_rad: -16.0_f64.to_radians(),
            elevation_max_rad: 6.0_f64.to_radians(),
            half_sector_rad: 44.5 * STEP_RAD,
            azimuth_step_rad: STEP_RAD,
            ..LidarConfig::default()
        },
        ..StreetConfig::default()
    }
}

/// A copy of the log; generated once.
pub(crate) fn street() -> ReadLog {
    static STREET: OnceLock<ReadLog> = OnceLock::new();
    copy(STREET.get_or_init(record))
}

pub(crate) fn copy(log: &ReadLog) -> ReadLog {
    ReadLog {
        drive_log: log.drive_log.clone(),
        blobs: log.blobs.clone(),
    }
}

fn record() -> ReadLog {
    let world = StreetWorld::new(&config()).expect("the street is valid");
    let mut log = world.read_log().expect("the street is recorded");
    to_jpeg(&mut log);
    add_side_camera(&mut log);
    tilt_world(&mut log.drive_log);
    log
}

/// Every data set but KITTI has JPEG images; masks and sky are not in any of them.
fn to_jpeg(log: &mut ReadLog) {
    let mut frames = std::mem::take(&mut log.drive_log.frames);
    for frame in &mut frames {
        let png = log
            .read_blob(frame.image.as_ref().expect("a frame has an image"))
            .expect("the image is in memory");
        let image = image::load_from_memory(&png).expect("the image decodes");
        let mut jpeg = Cursor::new(Vec::new());
        image
            .write_to(&mut jpeg, image::ImageFormat::Jpeg)
            .expect("the image encodes");
        frame.image = Some(log.add_bytes(jpeg.into_inner()));
        (frame.instance_mask, frame.sky_mask) = (None, None);
    }
    log.drive_log.frames = frames;
    let used = |digest: &String| {
        let frames = log.drive_log.frames.iter().map(|f| &f.image);
        let sweeps = log.drive_log.sweeps.iter().map(|s| &s.points);
        frames
            .chain(sweeps)
            .flatten()
            .any(|blob| blob.digest == *digest)
    };
    log.blobs.retain(|digest, _| used(digest));
}

/// A second camera that looks left, rolled and of another focal length, with the first one's images 40 ms later.
fn add_side_camera(log: &mut ReadLog) {
    let log = &mut log.drive_log;
    let front = log.cameras[0].clone();
    let ego_from_front = rigid_from_wire(front.ego_from_camera.as_ref());
    let front_from_side = Rigid::new(
        DQuat::from_euler(EulerRot::YXZ, -0.6, 0.05, 0.04),
        DVec3::new(-0.4, 0.1, -0.2),
    );
    log.cameras.push(v1::Camera {
        camera_id: "side".to_owned(),
        focal_x_px: 71.0,
        focal_y_px: 69.5,
        principal_x_px: 50.25,
        principal_y_px: 30.75,
        ego_from_camera: Some(rigid_to_wire(&(ego_from_front * front_from_side))),
        ..front
    });
    let later: Vec<v1::CameraFrame> = log
        .frames
        .iter()
        .map(|frame| v1::CameraFrame {
            camera_id: "side".to_owned(),
            timestamp_ns: frame.timestamp_ns + 40_000_000,
            ..frame.clone()
        })
        .collect();
    log.frames.extend(later);
}

/// Maps have their origins far away and streets are not level: an axis that is mixed up must show.
fn tilt_world(log: &mut v1::DriveLog) {
    let tilted_from_world = Rigid::new(
        DQuat::from_euler(EulerRot::ZYX, 0.7, 0.05, -0.03),
        DVec3::new(613.2, -1482.7, 12.5),
    );
    let tilt = |pose: &mut Option<v1::RigidTransform>| {
        *pose = Some(rigid_to_wire(
            &(tilted_from_world * rigid_from_wire(pose.as_ref())),
        ));
    };
    log.world_from_ego
        .iter_mut()
        .for_each(|p| tilt(&mut p.pose));
    let states = log.tracks.iter_mut().flat_map(|t| &mut t.states);
    states.for_each(|s| tilt(&mut s.world_from_cuboid));
}

/// Boxes that only turn about the vehicle's z axis, with states at the given times: all that some data sets can say.
pub(crate) fn with_upright_boxes(mut log: ReadLog, times_ns: &[i64]) -> ReadLog {
    let manifest = &mut log.drive_log;
    let mut tracks = std::mem::take(&mut manifest.tracks);
    for track in &mut tracks {
        let upright = times_ns.iter().map(|&timestamp_ns| {
            let world_from_ego = ego_at(manifest, timestamp_ns);
            let pose = track_pose_at(track, timestamp_ns).expect("the track covers the log");
            let in_ego = world_from_ego.inverse() * pose;
            let level = Rigid::from_heading(in_ego.heading_rad(), in_ego.translation_m);
            v1::TrackState {
                timestamp_ns,
                world_from_cuboid: Some(rigid_to_wire(&(world_from_ego * level))),
                truncation: -1.0,
                ..Default::default()
            }
        });
        track.states = upright.collect();
    }
    manifest.tracks = tracks;
    log
}

/// One return of a sweep.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Return {
    /// LiDAR frame at the time of the point.
    pub(crate) position_m: DVec3,
    pub(crate) intensity: f32,
    pub(crate) timestamp_ns: i64,
}

/// The returns of a sweep of either format.
pub(crate) fn returns(log: &ReadLog, sweep: &v1::LidarSweep) -> Vec<Return> {
    let content = log
        .read_blob(sweep.points.as_ref().expect("a sweep has points"))
        .expect("the points are readable");
    let floats: Vec<f32> = content
        .chunks_exact(4)
        .map(|b| f32::from_le_bytes(b.try_into().expect("4 bytes")))
        .collect();
    let timed = sweep.format() == v1::PointFormat::XyzitF32;
    floats
        .chunks_exact(if timed { 5 } else { 4 })
        .map(|p| Return {
            position_m: DVec3::new(p[0].into(), p[1].into(), p[2].into()),
            intensity: p[3],
            timestamp_ns: sweep.timestamp_ns
                + if timed {
                    (f64::from(p[4]) * 1e9).round() as i64
                } else {
                    0
                },
        })
        .collect()
}

/// A return in the world.
pub(crate) fn world_m(log: &v1::DriveLog, sweep: &v1::LidarSweep, point: &Return) -> DVec3 {
    let ego_from_lidar = rigid_from_wire(sweep.ego_from_lidar.as_ref());
    let world_from_ego = ego_at(log, point.timestamp_ns);
    (world_from_ego * ego_from_lidar).point(point.position_m)
}

pub(crate) fn ego_at(log: &v1::DriveLog, timestamp_ns: i64) -> Rigid {
    ego_pose_at(&log.world_from_ego, timestamp_ns).expect("the trajectory covers the time")
}

/// Every return of a sweep moved to where the scanner sees it at the sweep's own time, as data sets compensate ego motion.
pub(crate) fn compensated(log: &ReadLog, sweep: &v1::LidarSweep) -> Vec<Return> {
    let ego_from_lidar = rigid_from_wire(sweep.ego_from_lidar.as_ref());
    let lidar_from_world = (ego_at(&log.drive_log, sweep.timestamp_ns) * ego_from_lidar).inverse();
    returns(log, sweep)
        .into_iter()
        .map(|point| Return {
            position_m: lidar_from_world.point(world_m(&log.drive_log, sweep, &point)),
            timestamp_ns: sweep.timestamp_ns,
            ..point
        })
        .collect()
}
