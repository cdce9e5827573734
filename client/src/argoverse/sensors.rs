//! Images and sweeps of a log.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use backlot_proto::v1;
use glam::DVec3;
use rayon::prelude::*;

use super::calibration::Calibration;
use super::feather::Columns;
use crate::geometry::{camera_to_wire, rigid_to_wire};
use crate::read_log::content::{check_image, push_point};
use crate::read_log::{Error, ReadLog, Result, SpoolWriter};

/// The sweeps of both scanners are one point cloud; its rays are taken to start at the upper one, 8 cm above the other.
const LIDAR: &str = "up_lidar";
/// Intensities are 0 to 255.
const MAX_INTENSITY: f64 = 255.0;
/// Sweeps converted at once; each is held in memory while it is.
const BATCH: usize = 16;

/// Adds every camera that has images.
pub(super) fn add_cameras(
    log: &mut ReadLog,
    log_dir: &Path,
    calibration: &Calibration,
) -> Result<()> {
    let cameras = log_dir.join("sensors/cameras");
    let folders = subfolders(&cameras)?;
    for name in calibration.camera_names() {
        if !folders.contains_key(name) {
            log.drive_log.notes.push(format!("no images of {name}"));
        }
    }
    for (name, folder) in folders {
        let files = timed_files(&folder, "jpg")?;
        if files.is_empty() {
            log.drive_log.notes.push(format!("no images of {name}"));
            continue;
        }
        let camera = calibration.camera(&name)?;
        let size = (camera.width, camera.height);
        let checked: Vec<_> = files
            .par_iter()
            .map(|(time, path)| Ok((*time, path, check_image(path, size, "intrinsics.feather")?)))
            .collect::<Result<_>>()?;
        let ego_from_camera = calibration.ego_from_sensor(&name)?;
        let wire = camera_to_wire(&name, camera, &ego_from_camera);
        log.drive_log.cameras.push(wire);
        for (i, (timestamp_ns, path, image)) in checked.into_iter().enumerate() {
            log.add_file(path, &image);
            log.drive_log.frames.push(v1::CameraFrame {
                camera_id: name.clone(),
                frame_index: i as u32,
                timestamp_ns,
                image: Some(image),
                ..Default::default()
            });
        }
    }
    if log.drive_log.frames.is_empty() {
        return Err(Error::Missing {
            path: cameras.join("*/*.jpg"),
            hint: "an Argoverse 2 sensor log has its images there".to_owned(),
        });
    }
    Ok(())
}

/// Adds the sweeps. The data set compensated them for ego motion to the time in the file's name.
pub(super) fn add_sweeps(
    log: &mut ReadLog,
    log_dir: &Path,
    calibration: &Calibration,
) -> Result<()> {
    let folder = log_dir.join("sensors/lidar");
    let files: Vec<_> = timed_files(&folder, "feather")?.into_iter().collect();
    if files.is_empty() {
        log.drive_log.notes.push("no LiDAR sweeps".to_owned());
        return Ok(());
    }
    let ego_from_lidar = calibration.ego_from_sensor(LIDAR)?;
    let lidar_from_ego = ego_from_lidar.inverse();
    let failed = |e| Error::io(&std::env::temp_dir(), e, "");
    let mut spool = SpoolWriter::new().map_err(failed)?;
    for batch in files.chunks(BATCH) {
        let converted: Vec<Vec<u8>> = batch
            .par_iter()
            .map(|(_, path)| convert_sweep(path, |p| lidar_from_ego.point(p)))
            .collect::<Result<_>>()?;
        for ((timestamp_ns, _), points) in batch.iter().zip(converted) {
            let points = log.add_spooled(&mut spool, &points).map_err(failed)?;
            log.drive_log.sweeps.push(v1::LidarSweep {
                lidar_id: LIDAR.to_owned(),
                timestamp_ns: *timestamp_ns,
                ego_from_lidar: Some(rigid_to_wire(&ego_from_lidar)),
                points: Some(points),
                format: v1::PointFormat::XyziF32.into(),
            });
        }
    }
    Ok(())
}

/// Reads a sweep, whose points are in the ego frame, into XYZI points.
fn convert_sweep(path: &Path, lidar_from_ego: impl Fn(DVec3) -> DVec3) -> Result<Vec<u8>> {
    let columns = Columns::read(path, &["x", "y", "z", "intensity"], "")?;
    let [x, y, z] = [
        columns.numbers("x")?,
        columns.numbers("y")?,
        columns.numbers("z")?,
    ];
    let intensity = columns.numbers("intensity")?;
    let mut points = Vec::with_capacity(x.len() * 16);
    for (i, &x) in x.iter().enumerate() {
        let p_ego = DVec3::new(x, y[i], z[i]);
        if p_ego.is_finite() {
            let share = (intensity[i] / MAX_INTENSITY) as f32;
            push_point(&mut points, lidar_from_ego(p_ego), share);
        }
    }
    if points.is_empty() {
        return Err(Error::malformed(path, "the sweep has no finite point"));
    }
    Ok(points)
}

fn subfolders(folder: &Path) -> Result<BTreeMap<String, PathBuf>> {
    let mut folders = BTreeMap::new();
    let hint = "an Argoverse 2 sensor log has its images there";
    for entry in std::fs::read_dir(folder).map_err(|e| Error::io(folder, e, hint))? {
        let path = entry.map_err(|e| Error::io(folder, e, ""))?.path();
        if let Some(name) = path.file_name().and_then(|n| n.to_str())
            && path.is_dir()
        {
            folders.insert(name.to_owned(), path);
        }
    }
    Ok(folders)
}

/// `<nanoseconds>.<extension>` files by time; empty if the folder is missing.
fn timed_files(folder: &Path, extension: &str) -> Result<BTreeMap<i64, PathBuf>> {
    let mut files = BTreeMap::new();
    if !folder.exists() {
        return Ok(files);
    }
    for entry in std::fs::read_dir(folder).map_err(|e| Error::io(folder, e, ""))? {
        let path = entry.map_err(|e| Error::io(folder, e, ""))?.path();
        if path.extension().is_some_and(|e| e == extension) {
            let stem = path.file_stem().and_then(|s| s.to_str()).unwrap_or("");
            let time = stem.parse().ok().filter(|time| *time >= 0);
            let what = "the file name is not a time in nanoseconds";
            let time = time.ok_or_else(|| Error::malformed(&path, what))?;
            files.insert(time, path);
        }
    }
    Ok(files)
}
