//! Sequences of the tracking benchmark: `image_02`, `velodyne`, `calib`, `oxts` and `label_02`, each with all sequences.

use std::path::{Path, PathBuf};

use super::calibration::Calibration;
use super::clock::Clock;
use super::{drive, ego_motion, place_tracks, poses, sensors, tracking_labels};
use crate::geometry::{camera_to_wire, rigid_to_wire};
use crate::read_log::{Error, ReadLog, Result, choice};

/// Which sequence.
#[derive(Clone, Debug)]
pub struct KittiTrackingInputs {
    /// The folder `training` or `testing`.
    pub root: PathBuf,
    /// Name of the sequence, e.g. `0001`; needed where there are several.
    pub sequence: Option<String>,
}

/// True for a folder that [`read_kitti_tracking`] can read.
pub fn is_kitti_tracking(path: &Path) -> bool {
    path.join("image_02").is_dir() && path.join("calib").is_dir()
}

/// Reads a sequence: left colour images, Velodyne sweeps, ego poses and tracks.
///
/// The benchmark has no timestamps: frames are taken to be 0.1033 s apart, with a note in the manifest.
///
/// # Errors
/// Names the file, and the line and field or the frame, that is missing or unusable.
pub fn read_kitti_tracking(inputs: &KittiTrackingInputs) -> Result<ReadLog> {
    let root = &inputs.root;
    let sequence = choose(root, inputs.sequence.as_deref())?;
    let file = |folder: &str| root.join(folder).join(format!("{sequence}.txt"));
    let mut notes = vec![
        format!("sequence {sequence}"),
        "no timestamps: frames are assumed to be 0.1033 s apart".to_owned(),
    ];
    let hint =
        "PATH must be the folder of a KITTI tracking split with images in image_02/<sequence>";
    let images = sensors::image_files(&root.join("image_02").join(&sequence), hint)?;
    let first = images.values().next().expect("there is an image");
    let calibration = Calibration::read_tracking(&file("calib"), drive::image_size(first)?)?;
    let frames = sensors::frame_times(first, &images, &Clock::Assumed)?;
    let packets = file("oxts");
    let (trajectory, local_from_world) = ego_motion::from_packets(
        &poses::read_oxts_lines(&packets)?,
        &Clock::Assumed,
        &calibration,
        &frames,
        &packets,
    )?;
    let mut log = ReadLog::default();
    sensors::add_frames(&mut log, &images, &frames, &calibration)?;
    let sweeps = root.join("velodyne").join(&sequence);
    sensors::add_sweeps(&mut log, &sweeps, &Clock::Assumed, &frames, &mut notes)?;
    let labels = file("label_02");
    let tracks = if labels.exists() {
        tracking_labels::read(&labels, &calibration.camera0_from_velodyne.inverse())?
    } else {
        notes.push("no label_02: nothing tells movers from the background".to_owned());
        Vec::new()
    };
    log.drive_log.tracks = place_tracks(&tracks, &frames, &trajectory, &mut notes);
    log.drive_log.notes = notes;
    log.drive_log.dataset = "kitti-tracking".to_owned();
    log.drive_log.local_from_world = Some(rigid_to_wire(&local_from_world));
    let ego_from_camera = calibration.velodyne_from_camera2();
    let camera = camera_to_wire(sensors::CAMERA_ID, &calibration.camera, &ego_from_camera);
    log.drive_log.cameras = vec![camera];
    trajectory.record(&mut log.drive_log);
    Ok(log)
}

fn choose(root: &Path, wanted: Option<&str>) -> Result<String> {
    let folder = root.join("image_02");
    let hint = "PATH must be the folder of a KITTI tracking split, with image_02, velodyne, calib, oxts and label_02";
    let mut sequences = Vec::new();
    for entry in std::fs::read_dir(&folder).map_err(|e| Error::io(&folder, e, hint))? {
        let entry = entry.map_err(|e| Error::io(&folder, e, ""))?;
        if entry.path().is_dir() {
            sequences.push(entry.file_name().to_string_lossy().into_owned());
        }
    }
    sequences.sort();
    choice::choose(root, "sequence", &sequences, wanted)
}
