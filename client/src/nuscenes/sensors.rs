//! Cameras, images and sweeps of a scene.

use std::f64::consts::FRAC_PI_2;
use std::path::{Component, Path, PathBuf};

use backlot_engine::camera::{Camera, Distortion, Rigid};
use backlot_proto::v1;
use glam::{DVec2, DVec3};
use rayon::prelude::*;

use super::scene::{Recording, Scene, Sensor};
use crate::geometry::{camera_to_wire, rigid_to_wire};
use crate::read_log::content::{check_image, push_point};
use crate::read_log::{Error, ReadLog, Result, SpoolWriter};

/// Bytes of one point: little-endian f32 x, y, z, intensity, ring.
const POINT_BYTES: usize = 20;
/// Intensities of the scanner are 0 to 255.
const MAX_INTENSITY: f32 = 255.0;
/// Sweeps converted at once; each is held in memory while it is.
const BATCH: usize = 16;

/// Adds every camera with its images.
pub(super) fn add_cameras(
    log: &mut ReadLog,
    root: &Path,
    scene: &Scene,
    calibration_file: &Path,
) -> Result<()> {
    for (channel, sensor) in scene.sensors.iter().filter(|(_, s)| s.modality == "camera") {
        let recordings = on_disk(root, channel, sensor, &mut log.drive_log.notes)?;
        let Some((first, _)) = recordings.first() else {
            continue;
        };
        let camera = camera(sensor, first.size)
            .map_err(|what| Error::malformed(calibration_file, format!("{channel}: {what}")))?;
        let wire = camera_to_wire(channel, &camera, &sensor.ego_from_sensor);
        log.drive_log.cameras.push(wire);
        let images: Vec<_> = recordings
            .par_iter()
            .map(|(_, path)| check_image(path, first.size, "sample_data.json"))
            .collect::<Result<_>>()?;
        for (i, ((recording, path), image)) in recordings.iter().zip(images).enumerate() {
            log.add_file(path, &image);
            log.drive_log.frames.push(v1::CameraFrame {
                camera_id: channel.clone(),
                frame_index: i as u32,
                timestamp_ns: recording.timestamp_ns,
                image: Some(image),
                ..Default::default()
            });
        }
    }
    Ok(())
}

/// The images are rectified. nuScenes counts pixels from the centre of the first one, the manifest from its corner.
fn camera(sensor: &Sensor, (width, height): (u32, u32)) -> Result<Camera, String> {
    let [[fx, skew, cx], [zero, fy, cy], last] = sensor.intrinsic[..] else {
        return Err("camera_intrinsic is not a 3x3 matrix".to_owned());
    };
    if skew != 0.0 || zero != 0.0 || last != [0.0, 0.0, 1.0] {
        return Err("camera_intrinsic is not a pinhole camera's without skew".to_owned());
    }
    let camera = Camera {
        width,
        height,
        focal_px: DVec2::new(fx, fy),
        principal_px: DVec2::new(cx, cy) + 0.5,
        distortion: Distortion::None,
    };
    camera
        .validate("camera_intrinsic")
        .map_err(|e| e.to_string())?;
    Ok(camera)
}

/// Adds the sweeps of every LiDAR.
pub(super) fn add_sweeps(log: &mut ReadLog, root: &Path, scene: &Scene) -> Result<()> {
    let failed = |e| Error::io(&std::env::temp_dir(), e, "");
    let mut spool = SpoolWriter::new().map_err(failed)?;
    for (channel, sensor) in scene.sensors.iter().filter(|(_, s)| s.modality == "lidar") {
        // The scanner's x is right and its y forward; the manifest's x is forward and its y left.
        let turn = Rigid::from_heading(FRAC_PI_2, DVec3::ZERO);
        let ego_from_lidar = rigid_to_wire(&(sensor.ego_from_sensor * turn));
        let recordings = on_disk(root, channel, sensor, &mut log.drive_log.notes)?;
        for batch in recordings.chunks(BATCH) {
            let converted: Vec<Vec<u8>> = batch
                .par_iter()
                .map(|(_, path)| convert_sweep(path))
                .collect::<Result<_>>()?;
            for ((recording, _), points) in batch.iter().zip(converted) {
                let points = log.add_spooled(&mut spool, &points).map_err(failed)?;
                // The data set compensated the points for ego motion to the sweep's time.
                log.drive_log.sweeps.push(v1::LidarSweep {
                    lidar_id: channel.clone(),
                    timestamp_ns: recording.timestamp_ns,
                    ego_from_lidar: Some(ego_from_lidar),
                    points: Some(points),
                    format: v1::PointFormat::XyziF32.into(),
                });
            }
        }
    }
    Ok(())
}

/// Reads a `.pcd.bin` into XYZI points with x forward.
fn convert_sweep(path: &Path) -> Result<Vec<u8>> {
    let content = std::fs::read(path).map_err(|e| Error::io(path, e, ""))?;
    if content.is_empty() || content.len() % POINT_BYTES != 0 {
        let what = format!(
            "{} bytes are not one or more {POINT_BYTES}-byte points: the file is empty or truncated",
            content.len()
        );
        return Err(Error::malformed(path, what));
    }
    let mut points = Vec::with_capacity(content.len() / POINT_BYTES * 16);
    for point in content.chunks_exact(POINT_BYTES) {
        let value =
            |k: usize| f32::from_le_bytes(point[4 * k..4 * k + 4].try_into().expect("4 bytes"));
        let p = DVec3::new(value(1).into(), (-value(0)).into(), value(2).into());
        if p.is_finite() {
            push_point(&mut points, p, value(3) / MAX_INTENSITY);
        }
    }
    if points.is_empty() {
        return Err(Error::malformed(path, "the sweep has no finite point"));
    }
    Ok(points)
}

/// The recordings that are there: keyframes must be; the sweeps between them are downloaded separately and may be missing.
fn on_disk<'a>(
    root: &Path,
    channel: &str,
    sensor: &'a Sensor,
    notes: &mut Vec<String>,
) -> Result<Vec<(&'a Recording, PathBuf)>> {
    let mut present = Vec::new();
    for recording in &sensor.recordings {
        let path = inside(root, &recording.filename)?;
        if recording.is_key_frame || path.exists() {
            present.push((recording, path));
        }
    }
    let missing = sensor.recordings.len() - present.len();
    if missing > 0 {
        notes.push(format!(
            "{missing} recordings of {channel} between keyframes are not on disk and left out"
        ));
    }
    Ok(present)
}

/// A table must not lead out of the data set.
fn inside(root: &Path, filename: &str) -> Result<PathBuf> {
    let relative = Path::new(filename);
    let stays = relative
        .components()
        .all(|c| matches!(c, Component::Normal(_)));
    if stays && !filename.is_empty() {
        Ok(root.join(relative))
    } else {
        let what = format!("sample_data.json names the file {filename:?}, which is not below it");
        Err(Error::malformed(root, what))
    }
}
