//! Reader of Argoverse 2 sensor logs: Feather tables and sweeps, JPEG images.
//!
//! The world is the city's frame, the ego frame the middle of the rear axle (x forward, y left, z up). Images are undistorted and
//! taken with a global shutter; boxes are annotated at the sweeps. Sweeps were compensated for ego motion to their own time.

mod feather;

mod poses;

mod calibration;
mod sensors;

mod boxes;

use std::path::{Path, PathBuf};

use crate::geometry::rigid_to_wire;
use crate::read_log::{Error, ReadLog, Result, choice};
use calibration::Calibration;

/// Which log.
#[derive(Clone, Debug)]
pub struct ArgoverseInputs {
    /// The folder of the log, with `city_SE3_egovehicle.feather`; or of a split, with such folders.
    pub path: PathBuf,
    /// Name of the log's folder; needed where there are several.
    pub log: Option<String>,
}

/// True for a folder that [`read_argoverse`] can read.
pub fn is_argoverse(path: &Path) -> bool {
    is_log(path) || logs_in(path).is_ok_and(|logs| !logs.is_empty())
}

/// Reads a log: images of all cameras, LiDAR sweeps, ego poses and tracks.
///
/// # Errors
/// Names the file, and the column or row, that is missing or unusable.
pub fn read_argoverse(inputs: &ArgoverseInputs) -> Result<ReadLog> {
    let log_dir = locate(inputs)?;
    let calibration = Calibration::read(&log_dir)?;
    let trajectory = poses::read_trajectory(&log_dir)?;
    let mut log = ReadLog::default();
    log.drive_log.dataset = "argoverse2".to_owned();
    sensors::add_cameras(&mut log, &log_dir, &calibration)?;
    sensors::add_sweeps(&mut log, &log_dir, &calibration)?;
    let notes = &mut log.drive_log.notes;
    log.drive_log.tracks = boxes::read(&log_dir, &trajectory, notes)?;
    log.drive_log.local_from_world = Some(rigid_to_wire(&trajectory.local_from_world()));
    trajectory.record(&mut log.drive_log);
    Ok(log)
}

fn is_log(path: &Path) -> bool {
    path.join(poses::EGO_POSES).is_file()
}

fn logs_in(path: &Path) -> std::io::Result<Vec<String>> {
    let mut logs = Vec::new();
    for entry in std::fs::read_dir(path)? {
        let entry = entry?;
        if is_log(&entry.path()) {
            logs.push(entry.file_name().to_string_lossy().into_owned());
        }
    }
    logs.sort();
    Ok(logs)
}

fn locate(inputs: &ArgoverseInputs) -> Result<PathBuf> {
    let path = &inputs.path;
    if is_log(path) {
        return Ok(path.clone());
    }
    let logs = logs_in(path).map_err(|e| Error::io(path, e, "PATH must be an Argoverse 2 log"))?;
    if logs.is_empty() {
        return Err(Error::Missing {
            path: path.join(poses::EGO_POSES),
            hint: "PATH must be an Argoverse 2 sensor log".to_owned(),
        });
    }
    let log = choice::choose(path, "log", &logs, inputs.log.as_deref())?;
    Ok(path.join(log))
}
