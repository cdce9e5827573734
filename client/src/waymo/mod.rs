//! Reader of the Waymo Open data set, version 2: a Parquet file for each component and segment.
//!
//! The world is the data set's global frame, the ego frame the vehicle's (x forward, y left, z up). Cameras have a rolling shutter
//! and lens distortion, both of which the manifest carries. Boxes are those of the LiDAR at the frames' times; range images become
//! points of both returns, compensated for ego motion to the frame's time with the poses of their pixels.

mod pages;
mod table;

mod transform;

mod cameras;

mod sky;

mod lidar;

mod boxes;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use backlot_engine::camera::Rigid;

use crate::geometry::rigid_to_wire;
use crate::read_log::content::time_of_micros;
use crate::read_log::trajectory::Trajectory;
use crate::read_log::{Error, ReadLog, Result, SpoolWriter, choice};
use table::Table;

/// Which segment.
#[derive(Clone, Debug)]
pub struct WaymoInputs {
    /// The folder of the components `camera_image`, `vehicle_pose` and so on, e.g. `training`.
    pub root: PathBuf,
    /// Name of the segment; needed where there are several.
    pub segment: Option<String>,
}

/// True for a folder that [`read_waymo`] can read.
pub fn is_waymo(path: &Path) -> bool {
    path.join("camera_image").is_dir() && path.join("vehicle_pose").is_dir()
}

/// Reads a segment: images of all cameras, LiDAR sweeps, ego poses and tracks.
///
/// # Errors
/// Names the file, and the row and column, that is missing or unusable.
pub fn read_waymo(inputs: &WaymoInputs) -> Result<ReadLog> {
    let root = &inputs.root;
    let segment = choose(root, inputs.segment.as_deref())?;
    let world_from_vehicle = read_vehicle_poses(root, &segment)?;
    let failed = |e| Error::io(&std::env::temp_dir(), e, "");
    let mut spool = SpoolWriter::new().map_err(failed)?;
    let mut log = ReadLog::default();
    log.drive_log.dataset = "waymo".to_owned();
    log.drive_log.notes = vec![format!("segment {segment}")];
    let mut poses = world_from_vehicle.clone();
    let keys = cameras::add_cameras(&mut log, &mut spool, root, &segment, &mut poses)?;
    if log.drive_log.frames.is_empty() {
        let path = root.join("camera_image").join(format!("{segment}.parquet"));
        return Err(Error::malformed(&path, "holds no image"));
    }
    sky::add_masks(&mut log, &mut spool, root, &segment, &keys)?;
    lidar::add_sweeps(&mut log, &mut spool, root, &segment, &world_from_vehicle)?;
    let notes = &mut log.drive_log.notes;
    log.drive_log.tracks = boxes::read(root, &segment, &world_from_vehicle, notes)?;
    let trajectory = Trajectory::new(poses);
    log.drive_log.local_from_world = Some(rigid_to_wire(&trajectory.local_from_world()));
    trajectory.record(&mut log.drive_log);
    Ok(log)
}

/// Poses of the frames by time in nanoseconds.
fn read_vehicle_poses(root: &Path, segment: &str) -> Result<BTreeMap<i64, Rigid>> {
    const POSE: &str = "[VehiclePoseComponent].world_from_vehicle.transform";
    let table = Table::required(root, "vehicle_pose", segment)?;
    let mut rows = table.rows(&[cameras::FRAME_TIME, POSE], &[])?;
    let mut poses = BTreeMap::new();
    while let Some(row) = rows.next_row()? {
        let time = row.integer(cameras::FRAME_TIME)?;
        let time = time_of_micros(time).map_err(|e| row.bad(e))?;
        let pose = transform::rigid(&row.array(POSE)?).map_err(|e| row.bad(e))?;
        let later = poses.last_key_value().is_none_or(|(&last, _)| time > last);
        if !later {
            return Err(row.bad(format!(
                "timestamps are out of order: {time} ns is not later than the row before"
            )));
        }
        poses.insert(time, pose);
    }
    if poses.is_empty() {
        return Err(Error::malformed(table.path(), "holds no pose"));
    }
    Ok(poses)
}

fn choose(root: &Path, wanted: Option<&str>) -> Result<String> {
    let folder = root.join("camera_image");
    let hint = "PATH must hold the components of Waymo Open v2: camera_image, vehicle_pose, camera_calibration, ...";
    let mut segments = Vec::new();
    for entry in std::fs::read_dir(&folder).map_err(|e| Error::io(&folder, e, hint))? {
        let path = entry.map_err(|e| Error::io(&folder, e, ""))?.path();
        let stem = path.file_stem().and_then(|s| s.to_str());
        if let Some(stem) = stem.filter(|_| path.extension().is_some_and(|e| e == "parquet")) {
            segments.push(stem.to_owned());
        }
    }
    segments.sort();
    choice::choose(root, "segment", &segments, wanted)
}
