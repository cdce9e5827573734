//! Writes a log as nuScenes does: 13 JSON tables, JPEG images, `.pcd.bin` sweeps.

use std::fs;
use std::path::Path;

use backlot_client::geometry::{rigid_from_wire, vector_from_wire};
use backlot_client::motion::track_pose_at;
use backlot_client::read_log::ReadLog;
use backlot_engine::camera::Rigid;
use backlot_proto::v1;
use glam::DVec3;
use serde_json::{Value, json};

use crate::street::{compensated, ego_at};

pub(crate) const LIDAR: &str = "LIDAR_TOP";
const SCENE: &str = "scene-0001";
/// Every second sweep is a keyframe.
const KEYFRAME_STEP: usize = 2;

/// A token is 32 hexadecimal digits.
pub(crate) fn token(of: &str) -> String {
    blake3::hash(of.as_bytes()).to_hex()[..32].to_owned()
}

pub(crate) fn instance_token(track_id: &str) -> String {
    token(&format!("instance {track_id}"))
}

pub(crate) fn channel(camera_id: &str) -> String {
    format!("CAM_{}", camera_id.to_uppercase())
}

/// Times of the keyframes.
pub(crate) fn keyframe_times_ns(log: &v1::DriveLog) -> Vec<i64> {
    let sweeps = log.sweeps.iter().step_by(KEYFRAME_STEP);
    sweeps.map(|sweep| sweep.timestamp_ns).collect()
}

/// Writes the data set below `root`, as version `v1.0-mini`.
pub(crate) fn write(log: &ReadLog, root: &Path) {
    let manifest = &log.drive_log;
    let keyframes = keyframe_times_ns(manifest);
    let mut tables = Tables::default();
    write_fixed_tables(&mut tables, manifest, &keyframes, root);
    for camera in &manifest.cameras {
        write_camera(&mut tables, log, camera, &keyframes, root);
    }
    write_lidar(&mut tables, log, &keyframes, root);
    for track in &manifest.tracks {
        write_track(&mut tables, track, &keyframes);
    }
    let folder = root.join("v1.0-mini");
    fs::create_dir_all(&folder).expect("the folder is writable");
    for (name, rows) in tables.0 {
        let text = serde_json::to_string(&rows).expect("rows are JSON");
        fs::write(folder.join(format!("{name}.json")), text).expect("the table is writable");
    }
}

#[derive(Default)]
struct Tables(std::collections::BTreeMap<&'static str, Vec<Value>>);

impl Tables {
    fn add(&mut self, table: &'static str, row: Value) {
        self.0.entry(table).or_default().push(row);
    }
}

fn micros(ns: i64) -> i64 {
    assert_eq!(ns % 1000, 0, "nuScenes has no nanoseconds");
    ns / 1000
}

fn wxyz(pose: &Rigid) -> [f64; 4] {
    let q = pose.rotation;
    [q.w, q.x, q.y, q.z]
}

fn write_fixed_tables(tables: &mut Tables, log: &v1::DriveLog, keyframes: &[i64], root: &Path) {
    tables.0.insert("attribute", Vec::new());
    for (i, level) in ["v0-40", "v40-60", "v60-80", "v80-100"].iter().enumerate() {
        let row = json!({"token": (i + 1).to_string(), "level": level, "description": ""});
        tables.add("visibility", row);
    }
    for name in ["vehicle.car", "vehicle.emergency.ambulance"] {
        tables.add(
            "category",
            json!({"token": token(name), "name": name, "description": ""}),
        );
    }
    tables.add(
        "log",
        json!({"token": token("log"), "logfile": "", "vehicle": "", "date_captured": "2023-11-14", "location": "street"}),
    );
    // The development kit wants the map's file to be there.
    let map = format!("maps/{}.png", token("map"));
    fs::create_dir_all(root.join("maps")).expect("the folder is writable");
    let grey = image::GrayImage::new(8, 8);
    grey.save(root.join(&map)).expect("the map is writable");
    tables.add(
        "map",
        json!({"token": token("map"), "log_tokens": [token("log")], "category": "semantic_prior", "filename": map}),
    );
    let sample = |i: usize| token(&format!("sample {i}"));
    tables.add(
        "scene",
        json!({"token": token("scene"), "name": SCENE, "description": "", "log_token": token("log"),
            "nbr_samples": keyframes.len(), "first_sample_token": sample(0),
            "last_sample_token": sample(keyframes.len() - 1)}),
    );
    for (i, &at) in keyframes.iter().enumerate() {
        tables.add(
            "sample",
            json!({"token": sample(i), "timestamp": micros(at), "scene_token": token("scene"),
                "prev": if i > 0 { sample(i - 1) } else { String::new() },
                "next": if i + 1 < keyframes.len() { sample(i + 1) } else { String::new() }}),
        );
    }
    assert!(!log.sweeps.is_empty(), "keyframes are sweeps");
}

/// One recording for [`write_recordings`].
struct Recording {
    filename: String,
    timestamp_ns: i64,
    size: (u32, u32),
}

fn write_camera(
    tables: &mut Tables,
    log: &ReadLog,
    camera: &v1::Camera,
    keyframes: &[i64],
    root: &Path,
) {
    let channel = channel(&camera.camera_id);
    let intrinsic = json!([
        [camera.focal_x_px, 0.0, camera.principal_x_px - 0.5],
        [0.0, camera.focal_y_px, camera.principal_y_px - 0.5],
        [0.0, 0.0, 1.0]
    ]);
    let pose = rigid_from_wire(camera.ego_from_camera.as_ref());
    write_sensor(tables, &channel, "camera", &pose, intrinsic);
    let mut recordings = Vec::new();
    for frame in &log.drive_log.frames {
        if frame.camera_id != camera.camera_id {
            continue;
        }
        let blob = frame.image.as_ref().expect("a frame has an image");
        let at = micros(frame.timestamp_ns);
        let filename = format!("samples/{channel}/street__{channel}__{at}.jpg");
        put(
            root,
            &filename,
            &log.read_blob(blob).expect("the image is readable"),
        );
        recordings.push(Recording {
            filename,
            timestamp_ns: frame.timestamp_ns,
            size: (camera.width, camera.height),
        });
    }
    write_recordings(tables, &log.drive_log, &channel, &recordings, keyframes);
}

fn write_lidar(tables: &mut Tables, log: &ReadLog, keyframes: &[i64], root: &Path) {
    let mut recordings = Vec::new();
    let first = log.drive_log.sweeps[0].ego_from_lidar.as_ref();
    // x right, y forward.
    let turn = Rigid::from_heading(-std::f64::consts::FRAC_PI_2, DVec3::ZERO);
    write_sensor(
        tables,
        LIDAR,
        "lidar",
        &(rigid_from_wire(first) * turn),
        json!([]),
    );
    for sweep in &log.drive_log.sweeps {
        let mut content = Vec::new();
        for (i, point) in compensated(log, sweep).iter().enumerate() {
            let p = turn.inverse().point(point.position_m).as_vec3();
            for value in [p.x, p.y, p.z, point.intensity * 255.0, (i % 32) as f32] {
                content.extend_from_slice(&value.to_le_bytes());
            }
        }
        let at = micros(sweep.timestamp_ns);
        let filename = format!("samples/{LIDAR}/street__{LIDAR}__{at}.pcd.bin");
        put(root, &filename, &content);
        recordings.push(Recording {
            filename,
            timestamp_ns: sweep.timestamp_ns,
            size: (0, 0),
        });
    }
    write_recordings(tables, &log.drive_log, LIDAR, &recordings, keyframes);
}

fn write_sensor(
    tables: &mut Tables,
    channel: &str,
    modality: &str,
    pose: &Rigid,
    intrinsic: Value,
) {
    let sensor = token(&format!("sensor {channel}"));
    tables.add(
        "sensor",
        json!({"token": sensor, "channel": channel, "modality": modality}),
    );
    tables.add(
        "calibrated_sensor",
        json!({"token": token(&format!("calibrated {channel}")), "sensor_token": sensor,
            "translation": pose.translation_m.to_array(), "rotation": wxyz(pose), "camera_intrinsic": intrinsic}),
    );
}

/// Rows of `sample_data` and `ego_pose`: the recording nearest to each keyframe is part of it.
fn write_recordings(
    tables: &mut Tables,
    log: &v1::DriveLog,
    channel: &str,
    recordings: &[Recording],
    keyframes: &[i64],
) {
    let name = |i: usize| token(&format!("{channel} {i}"));
    let nearest: Vec<usize> = keyframes
        .iter()
        .map(|&at| {
            let distance = |i: &usize| (recordings[*i].timestamp_ns - at).abs();
            (0..recordings.len())
                .min_by_key(distance)
                .expect("a sensor recorded")
        })
        .collect();
    for (i, recording) in recordings.iter().enumerate() {
        let at = recording.timestamp_ns;
        let keyframe = nearest.iter().position(|&n| n == i);
        let following = keyframes.iter().position(|&k| k >= at);
        let sample = keyframe.or(following).unwrap_or(keyframes.len() - 1);
        let pose = ego_at(log, at);
        let pose_token = token(&format!("pose {channel} {i}"));
        tables.add(
            "ego_pose",
            json!({"token": pose_token, "timestamp": micros(at), "rotation": wxyz(&pose),
                "translation": pose.translation_m.to_array()}),
        );
        let image = recording.size.0 > 0;
        tables.add(
            "sample_data",
            json!({"token": name(i), "sample_token": token(&format!("sample {sample}")),
                "ego_pose_token": pose_token, "filename": recording.filename,
                "calibrated_sensor_token": token(&format!("calibrated {channel}")),
                "fileformat": if image { "jpg" } else { "pcd" },
                "width": recording.size.0, "height": recording.size.1,
                "timestamp": micros(at), "is_key_frame": keyframe.is_some(),
                "prev": if i > 0 { name(i - 1) } else { String::new() },
                "next": if i + 1 < recordings.len() { name(i + 1) } else { String::new() }}),
        );
    }
}

fn write_track(tables: &mut Tables, track: &v1::Track, keyframes: &[i64]) {
    let instance = instance_token(&track.track_id);
    let name = |i: usize| token(&format!("box {} {i}", track.track_id));
    let class = if track.source_class == "van" {
        "vehicle.emergency.ambulance"
    } else {
        "vehicle.car"
    };
    tables.add(
        "instance",
        json!({"token": instance, "category_token": token(class), "nbr_annotations": keyframes.len(),
            "first_annotation_token": name(0), "last_annotation_token": name(keyframes.len() - 1)}),
    );
    let size = vector_from_wire(track.size_m.as_ref());
    for (i, &at) in keyframes.iter().enumerate() {
        let pose = track_pose_at(track, at).expect("the track covers the log");
        tables.add(
            "sample_annotation",
            json!({"token": name(i), "sample_token": token(&format!("sample {i}")), "instance_token": instance,
                "visibility_token": "4", "attribute_tokens": [], "translation": pose.translation_m.to_array(),
                "size": [size.y, size.x, size.z], "rotation": wxyz(&pose), "num_lidar_pts": 1, "num_radar_pts": 0,
                "prev": if i > 0 { name(i - 1) } else { String::new() },
                "next": if i + 1 < keyframes.len() { name(i + 1) } else { String::new() }}),
        );
    }
}

/// Writes a file below `root`, with its folders.
pub(crate) fn put(root: &Path, relative: &str, content: &[u8]) {
    let path = root.join(relative);
    let folder = path.parent().expect("a file is in a folder");
    fs::create_dir_all(folder).expect("the folder is writable");
    fs::write(path, content).expect("the file is writable");
}
