//! Writes a log as KITTI does: a raw drive with oxts and tracklets, and a sequence of the tracking benchmark.

use std::fmt::Write;
use std::path::Path;

use backlot_client::geometry::{rigid_from_wire, rigid_to_wire, vector_from_wire};
use backlot_client::motion::track_pose_at;
use backlot_client::read_log::ReadLog;
use backlot_engine::camera::Rigid;
use backlot_proto::v1;
use glam::{DMat3, DQuat, DVec3, EulerRot};

use crate::nuscenes_files::put;
use crate::street::{compensated, ego_at, street, with_upright_boxes};

/// The drive below the recording day.
pub(crate) const DRIVE: &str = "2023_11_14/2023_11_14_drive_0001_sync";
const DAY: &str = "2023_11_14";
pub(crate) const SEQUENCE: &str = "0001";
/// Radius of the development kit's Mercator projection.
const EARTH_RADIUS_M: f64 = 6_378_137.0;
const LATITUDE_DEG: f64 = 49.0;
const LONGITUDE_DEG: f64 = 8.4;
/// The rectified camera 0 is this far left of the image's camera, and rectified by this rotation.
const BASELINE_M: f64 = 0.06;
/// Time between frames of a sequence without timestamps.
pub(crate) const ASSUMED_STEP_NS: i64 = 103_300_000;

/// The street as KITTI records it: one level camera, the scanner's frame as the ego's, sweeps at the images' times, a world that
/// begins at the first frame.
pub(crate) fn synchronous() -> ReadLog {
    let mut log = street();
    let ego_from_lidar = rigid_from_wire(log.drive_log.sweeps[0].ego_from_lidar.as_ref());
    log.drive_log.cameras.truncate(1);
    log.drive_log.frames.retain(|f| f.camera_id == "front");
    log.drive_log
        .frames
        .iter_mut()
        .for_each(|f| f.camera_id = "image_02".to_owned());
    let times: Vec<i64> = log
        .drive_log
        .frames
        .iter()
        .map(|f| f.timestamp_ns)
        .collect();
    let sweeps: Vec<_> = log.drive_log.sweeps.clone();
    let mut synchronous = Vec::new();
    for (sweep, &timestamp_ns) in sweeps.iter().zip(&times) {
        let mut points = Vec::new();
        for point in compensated(&log, sweep) {
            let p = point.position_m.as_vec3();
            for value in [p.x, p.y, p.z, point.intensity] {
                points.extend_from_slice(&value.to_le_bytes());
            }
        }
        synchronous.push(v1::LidarSweep {
            timestamp_ns,
            ego_from_lidar: Some(rigid_to_wire(&Rigid::IDENTITY)),
            points: Some(log.add_bytes(points)),
            format: v1::PointFormat::XyziF32.into(),
            ..sweep.clone()
        });
    }
    log.drive_log.sweeps = synchronous;
    let camera = &mut log.drive_log.cameras[0];
    camera.camera_id = "image_02".to_owned();
    let place = rigid_from_wire(camera.ego_from_camera.as_ref()).translation_m
        - ego_from_lidar.translation_m;
    let level = DMat3::from_cols(DVec3::NEG_Y, DVec3::NEG_Z, DVec3::X);
    camera.ego_from_camera = Some(rigid_to_wire(&Rigid::new(DQuat::from_mat3(&level), place)));
    move_origin(&mut log.drive_log, times[0], &ego_from_lidar);
    // One more than is written, so that a clock that is a little late is still covered.
    let labelled: Vec<i64> = times
        .iter()
        .copied()
        .chain([times[times.len() - 1] + 10_000_000])
        .collect();
    with_upright_boxes(log, &labelled)
}

fn move_origin(log: &mut v1::DriveLog, first_ns: i64, ego_from_lidar: &Rigid) {
    let origin = (ego_at(log, first_ns) * *ego_from_lidar).translation_m;
    let new_from_old = Rigid::new(DQuat::IDENTITY, -origin);
    for pose in &mut log.world_from_ego {
        let moved = new_from_old * rigid_from_wire(pose.pose.as_ref()) * *ego_from_lidar;
        pose.pose = Some(rigid_to_wire(&moved));
    }
    for state in log.tracks.iter_mut().flat_map(|t| &mut t.states) {
        let moved = new_from_old * rigid_from_wire(state.world_from_cuboid.as_ref());
        state.world_from_cuboid = Some(rigid_to_wire(&moved));
    }
}

/// Writes the synchronous street as a raw drive and returns it.
pub(crate) fn write_raw(root: &Path) -> ReadLog {
    let log = synchronous();
    write_raw_log(&log, root);
    log
}

pub(crate) fn write_raw_log(log: &ReadLog, root: &Path) {
    let manifest = &log.drive_log;
    let camera = &manifest.cameras[0];
    let mut cameras = format!(
        "calib_time: 09-Jan-2012 13:57:47\nS_rect_02: {:e} {:e}\n",
        f64::from(camera.width),
        f64::from(camera.height)
    );
    let calibration = Calibration::of(camera);
    writeln!(
        cameras,
        "R_rect_00: {}",
        numbers(&rows(&calibration.rectify))
    )
    .expect("text grows");
    writeln!(cameras, "P_rect_02: {}", numbers(&calibration.projection)).expect("text grows");
    put(
        root,
        &format!("{DAY}/calib_cam_to_cam.txt"),
        cameras.as_bytes(),
    );
    for (name, rigid) in [
        ("velo_to_cam", calibration.camera_from_velodyne),
        ("imu_to_velo", velodyne_from_imu()),
    ] {
        let text = format!(
            "calib_time: 15-Mar-2012 11:37:16\nR: {}\nT: {}\n",
            numbers(&rows(&rigid.rotation)),
            numbers(&rigid.translation_m.to_array())
        );
        put(root, &format!("{DAY}/calib_{name}.txt"), text.as_bytes());
    }
    let times: Vec<i64> = manifest.frames.iter().map(|f| f.timestamp_ns).collect();
    let stamps: String = times.iter().map(|&ns| timestamp(ns)).collect();
    for sensor in ["image_02", "velodyne_points", "oxts"] {
        put(
            root,
            &format!("{DRIVE}/{sensor}/timestamps.txt"),
            stamps.as_bytes(),
        );
    }
    for (i, packet) in packets(manifest).iter().enumerate() {
        put(
            root,
            &format!("{DRIVE}/oxts/data/{i:010}.txt"),
            packet.as_bytes(),
        );
    }
    put_recordings(
        log,
        root,
        &format!("{DRIVE}/image_02/data"),
        &format!("{DRIVE}/velodyne_points/data"),
        10,
    );
    put(
        root,
        &format!("{DRIVE}/tracklet_labels.xml"),
        tracklets(manifest, &times).as_bytes(),
    );
}

/// Writes the synchronous street as a sequence of a tracking split and returns it, at the times that the reader assumes.
pub(crate) fn write_tracking(root: &Path) -> ReadLog {
    let log = synchronous();
    write_tracking_log(&log, root);
    log
}

pub(crate) fn write_tracking_log(log: &ReadLog, root: &Path) {
    let manifest = &log.drive_log;
    let calibration = Calibration::of(&manifest.cameras[0]);
    let matrix = |rigid: &Rigid| {
        let (r, t) = (rows(&rigid.rotation), rigid.translation_m);
        let row = |i: usize| [r[3 * i], r[3 * i + 1], r[3 * i + 2], t[i]];
        numbers(&[row(0), row(1), row(2)].concat())
    };
    let text = format!(
        "P0: {p}\nP1: {p}\nP2: {p}\nP3: {p}\nR_rect {}\nTr_velo_cam {}\nTr_imu_velo {}\n",
        numbers(&rows(&calibration.rectify)),
        matrix(&calibration.camera_from_velodyne),
        matrix(&velodyne_from_imu()),
        p = numbers(&calibration.projection),
    );
    put(root, &format!("calib/{SEQUENCE}.txt"), text.as_bytes());
    put(
        root,
        &format!("oxts/{SEQUENCE}.txt"),
        packets(manifest).concat().as_bytes(),
    );
    put_recordings(
        log,
        root,
        &format!("image_02/{SEQUENCE}"),
        &format!("velodyne/{SEQUENCE}"),
        6,
    );
    put(
        root,
        &format!("label_02/{SEQUENCE}.txt"),
        labels(manifest, &calibration).as_bytes(),
    );
}

/// KITTI's chain from the scanner to the image.
struct Calibration {
    rectify: DQuat,
    camera_from_velodyne: Rigid,
    /// Row by row; its fourth column is the offset of the image's camera from camera 0.
    projection: [f64; 12],
    rectified0_from_velodyne: Rigid,
}

impl Calibration {
    fn of(camera: &v1::Camera) -> Self {
        let camera2_from_velodyne = rigid_from_wire(camera.ego_from_camera.as_ref()).inverse();
        let offset = DVec3::new(BASELINE_M, 0.002, -0.003);
        let rectified0_from_velodyne = Rigid::new(DQuat::IDENTITY, -offset) * camera2_from_velodyne;
        let rectify = DQuat::from_euler(EulerRot::XYZ, 0.01, -0.008, 0.004);
        let (fx, fy) = (camera.focal_x_px, camera.focal_y_px);
        let (cx, cy) = (camera.principal_x_px - 0.5, camera.principal_y_px - 0.5);
        let t = offset;
        Self {
            rectify,
            camera_from_velodyne: Rigid::new(rectify.conjugate(), DVec3::ZERO)
                * rectified0_from_velodyne,
            projection: [
                fx,
                0.0,
                cx,
                fx * t.x + cx * t.z,
                0.0,
                fy,
                cy,
                fy * t.y + cy * t.z,
                0.0,
                0.0,
                1.0,
                t.z,
            ],
            rectified0_from_velodyne,
        }
    }
}

fn velodyne_from_imu() -> Rigid {
    let turn = DQuat::from_euler(EulerRot::ZYX, 0.002, -0.004, 0.015);
    Rigid::new(turn, DVec3::new(-0.81, 0.32, -0.8))
}

/// Row by row.
fn rows(rotation: &DQuat) -> [f64; 9] {
    DMat3::from_quat(*rotation).transpose().to_cols_array()
}

fn numbers(values: &[f64]) -> String {
    let words: Vec<String> = values.iter().map(|v| format!("{v:e}")).collect();
    words.join(" ")
}

/// The street's times are on 2023-11-14 from 22:13:20 on.
fn timestamp(ns: i64) -> String {
    let of_day = ns - 1_700_000_000_000_000_000 + 20_000_000_000;
    format!(
        "2023-11-14 22:13:{:02}.{:09}\n",
        of_day / 1_000_000_000,
        of_day % 1_000_000_000
    )
}

/// An oxts line for each frame: the development kit's projection backwards.
fn packets(log: &v1::DriveLog) -> Vec<String> {
    let scale = LATITUDE_DEG.to_radians().cos() * EARTH_RADIUS_M;
    let east0 = scale * LONGITUDE_DEG.to_radians();
    let north0 = scale * ((90.0 + LATITUDE_DEG).to_radians() / 2.0).tan().ln();
    let imu = |at| ego_at(log, at) * velodyne_from_imu();
    // The projection is scaled at the first packet's latitude, so that one must be the constant.
    let first = imu(log.frames[0].timestamp_ns).translation_m;
    let packets = log.frames.iter().map(|frame| {
        let pose = imu(frame.timestamp_ns);
        let moved = pose.translation_m - first;
        let longitude = ((east0 + moved.x) / scale).to_degrees();
        let latitude = 2.0 * ((north0 + moved.y) / scale).exp().atan().to_degrees() - 90.0;
        let (yaw, pitch, roll) = pose.rotation.to_euler(EulerRot::ZYX);
        let rest = "0 ".repeat(24);
        format!(
            "{latitude:.17} {longitude:.17} {:.12} {roll:.17} {pitch:.17} {yaw:.17} {rest}\n",
            moved.z
        )
    });
    packets.collect()
}

fn put_recordings(log: &ReadLog, root: &Path, images: &str, sweeps: &str, digits: usize) {
    for (i, frame) in log.drive_log.frames.iter().enumerate() {
        let blob = frame.image.as_ref().expect("a frame has an image");
        let image = log.read_blob(blob).expect("the image is readable");
        put(root, &format!("{images}/{i:0digits$}.jpg"), &image);
    }
    for (i, sweep) in log.drive_log.sweeps.iter().enumerate() {
        let blob = sweep.points.as_ref().expect("a sweep has points");
        let points = log.read_blob(blob).expect("the points are readable");
        put(root, &format!("{sweeps}/{i:0digits$}.bin"), &points);
    }
}

/// Bottom centres in the scanner's frame with a heading about its z axis.
fn tracklets(log: &v1::DriveLog, times: &[i64]) -> String {
    let mut text = String::from(
        "<?xml version=\"1.0\" encoding=\"UTF-8\" standalone=\"yes\" ?>\n<!DOCTYPE boost_serialization>\n\
         <boost_serialization signature=\"serialization::archive\" version=\"9\">\n<tracklets version=\"0\">\n",
    );
    for track in &log.tracks {
        let size = vector_from_wire(track.size_m.as_ref());
        write!(
            text,
            "<item><objectType>Car</objectType><h>{}</h><w>{}</w><l>{}</l><first_frame>0</first_frame>\n<poses>\n",
            size.z, size.y, size.x
        )
        .expect("text grows");
        for &at in times {
            let pose = ego_at(log, at).inverse()
                * track_pose_at(track, at).expect("the track covers the log");
            let bottom = pose.translation_m - DVec3::Z * (size.z / 2.0);
            writeln!(
                text,
                "<item><tx>{}</tx><ty>{}</ty><tz>{}</tz><rx>0</rx><ry>0</ry><rz>{}</rz><state>2</state>\
                 <occlusion>0</occlusion><occlusion_kf>0</occlusion_kf><truncation>0</truncation></item>",
                bottom.x,
                bottom.y,
                bottom.z,
                pose.heading_rad()
            )
            .expect("text grows");
        }
        text.push_str("</poses><finished>1</finished></item>\n");
    }
    text + "</tracklets>\n</boost_serialization>\n"
}

/// Bottom centres in rectified camera 0 with a turn about its y axis, which points down.
fn labels(log: &v1::DriveLog, calibration: &Calibration) -> String {
    let mut text = String::new();
    for (i, frame) in log.frames.iter().enumerate() {
        let camera0_from_world =
            calibration.rectified0_from_velodyne * ego_at(log, frame.timestamp_ns).inverse();
        for (id, track) in log.tracks.iter().enumerate() {
            let pose = camera0_from_world
                * track_pose_at(track, frame.timestamp_ns).expect("the track covers the log");
            let size = vector_from_wire(track.size_m.as_ref());
            let bottom = pose.translation_m + DVec3::Y * (size.z / 2.0);
            let ahead = pose.direction(DVec3::X);
            let rotation_y = (-ahead.z).atan2(ahead.x);
            writeln!(
                text,
                "{i} {id} Car 0 0 0.0 0.0 0.0 0.0 0.0 {:.9} {:.9} {:.9} {:.9} {:.9} {:.9} {rotation_y:.9}",
                size.z, size.y, size.x, bottom.x, bottom.y, bottom.z
            )
            .expect("text grows");
        }
    }
    text
}
