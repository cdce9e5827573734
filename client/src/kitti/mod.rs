//! Readers of KITTI: raw drives, and sequences of the tracking benchmark.
//!
//! The ego frame is the Velodyne's (x forward, y left, z up). With a pose file the world is the ego frame of the first frame
//! used; with oxts it is east, north, up with its origin there, and the log's local frame is turned to the first heading.

mod text;

mod calibration;
mod clock;
mod drive;
mod poses;

mod ego_motion;
mod sensors;

mod boxes;
mod tracking_labels;
mod tracklets;

mod tracking;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use backlot_proto::v1;

use crate::geometry::{camera_to_wire, rigid_to_wire, vector_to_wire};
use crate::read_log::ReadLog;
use crate::read_log::trajectory::Trajectory;
pub use crate::read_log::{Error, Result};
use boxes::LabelledTrack;
use calibration::Calibration;
use clock::Clock;
pub use tracking::{KittiTrackingInputs, is_kitti_tracking, read_kitti_tracking};
#[cfg(test)]
pub(crate) use tracking_labels::camera_from_cuboid_rotation;

/// Where the parts of a drive are.
#[derive(Clone, Debug)]
pub struct KittiInputs {
    /// The `..._sync` folder, with `image_02/data`, `velodyne_points/data` and possibly `oxts/data`.
    pub drive_dir: PathBuf,
    /// Folder of the `calib_*.txt` files; by default the folder above the drive.
    pub calib_dir: Option<PathBuf>,
    /// Poses of rectified camera 0 in KITTI odometry format; by default the drive's oxts.
    pub poses: Option<PathBuf>,
    /// `tracklet_labels.xml` or a tracking label file; by default the drive's `tracklet_labels.xml` if it is there.
    pub tracks: Option<PathBuf>,
}

/// True for a folder that [`read_kitti_raw`] can read.
pub fn is_kitti_raw(path: &Path) -> bool {
    path.join("image_02/data").is_dir()
}

/// Reads a drive: left colour images, Velodyne sweeps, ego poses and tracks.
///
/// Poses, boxes and sweeps of frames without an image are left out with a note in the manifest.
///
/// # Errors
/// Names the file, and the line and field or the frame, that is missing or unusable.
pub fn read_kitti_raw(inputs: &KittiInputs) -> Result<ReadLog> {
    let drive = &inputs.drive_dir;
    let hint = "PATH must be a KITTI raw drive folder (..._sync) with images in image_02/data";
    let images = sensors::image_files(&drive.join("image_02/data"), hint)?;
    let calibration = Calibration::read(&calibration_folder(inputs))?;
    let clock = Clock::read(&drive.join("image_02"))?;
    let mut notes = Vec::new();
    if clock.is_assumed() {
        notes
            .push("no image_02/timestamps.txt: frames are assumed to be 0.1033 s apart".to_owned());
    }
    let frames = sensors::frame_times(&drive.join("image_02/timestamps.txt"), &images, &clock)?;
    let (trajectory, local_from_world) = match &inputs.poses {
        Some(path) => ego_motion::from_odometry(path, &calibration, &frames, &mut notes)?,
        None => ego_motion::from_oxts(drive, &calibration, &frames, &mut notes)?,
    };
    let mut log = ReadLog::default();
    sensors::add_frames(&mut log, &images, &frames, &calibration)?;
    let velodyne = drive.join("velodyne_points");
    let clock = Clock::read(&velodyne)?;
    sensors::add_sweeps(
        &mut log,
        &velodyne.join("data"),
        &clock,
        &frames,
        &mut notes,
    )?;
    let tracks = read_tracks(inputs, &calibration, &mut notes)?;
    log.drive_log.tracks = place_tracks(&tracks, &frames, &trajectory, &mut notes);
    log.drive_log.notes = notes;
    trajectory.record(&mut log.drive_log);
    log.drive_log.dataset = "kitti-raw".to_owned();
    log.drive_log.local_from_world = Some(rigid_to_wire(&local_from_world));
    log.drive_log.cameras = vec![camera_to_wire(
        sensors::CAMERA_ID,
        &calibration.camera,
        &calibration.velodyne_from_camera2(),
    )];
    Ok(log)
}

fn calibration_folder(inputs: &KittiInputs) -> PathBuf {
    inputs.calib_dir.clone().unwrap_or_else(|| {
        let drive = &inputs.drive_dir;
        // Canonical, so that the folder above "." is found too.
        let drive = drive.canonicalize().unwrap_or_else(|_| drive.clone());
        drive.parent().map_or(drive.clone(), Path::to_owned)
    })
}

fn read_tracks(
    inputs: &KittiInputs,
    calibration: &Calibration,
    notes: &mut Vec<String>,
) -> Result<Vec<LabelledTrack>> {
    let default = inputs.drive_dir.join("tracklet_labels.xml");
    let path = match &inputs.tracks {
        Some(path) => path,
        None if default.exists() => &default,
        None => {
            notes.push("no tracks: nothing tells movers from the background".to_owned());
            return Ok(Vec::new());
        }
    };
    match drive::first_byte(path, "--tracks names a label file")? {
        Some(b'<') => tracklets::read(path),
        _ => tracking_labels::read(path, &calibration.camera0_from_velodyne.inverse()),
    }
}

/// Places boxes in the world at the times of their frames.
fn place_tracks(
    tracks: &[LabelledTrack],
    frames: &BTreeMap<u32, i64>,
    trajectory: &Trajectory,
    notes: &mut Vec<String>,
) -> Vec<v1::Track> {
    let mut ignored = 0;
    let mut placed = Vec::new();
    for track in tracks {
        let mut states = Vec::new();
        for (frame, labelled) in &track.boxes {
            let Some(&timestamp_ns) = frames.get(frame) else {
                ignored += 1;
                continue;
            };
            let world_from_cuboid = trajectory.at(timestamp_ns) * labelled.velodyne_from_cuboid;
            states.push(v1::TrackState {
                timestamp_ns,
                world_from_cuboid: Some(rigid_to_wire(&world_from_cuboid)),
                occlusion: labelled.occlusion.into(),
                truncation: labelled.truncation,
            });
        }
        if !states.is_empty() {
            placed.push(v1::Track {
                track_id: track.track_id.clone(),
                object_class: boxes::object_class(&track.source_class).into(),
                source_class: track.source_class.clone(),
                size_m: Some(vector_to_wire(track.size_m)),
                states,
            });
        }
    }
    if ignored > 0 {
        notes.push(format!(
            "{ignored} boxes of frames without an image ignored"
        ));
    }
    placed
}

#[cfg(test)]
mod recorded_tests;
#[cfg(test)]
mod tests;
#[cfg(test)]
mod tracking_tests;
