//! Reader of nuScenes: the tables of a `v1.0-*` folder, camera images and LiDAR sweeps of one scene.
//!
//! The world is the map's frame, the ego frame the middle of the rear axle (x forward, y left, z up). Images are rectified.
//! Boxes are annotated at keyframes (2 Hz) and interpolated between them, linearly and by slerp, as the development kit does.
//! Sweeps were compensated for ego motion to their own time by the data set. Radar is not read.

mod tables;

mod scene;

mod sensors;

mod boxes;

use std::path::{Path, PathBuf};

use backlot_engine::camera::Rigid;
use glam::DVec3;

use crate::geometry::rigid_to_wire;
use crate::read_log::trajectory::Trajectory;
use crate::read_log::{Error, ReadLog, Result};
use scene::Scene;
use tables::Tables;

/// Which scene of which copy of the data set.
#[derive(Clone, Debug)]
pub struct NuscenesInputs {
    /// The folder that holds `v1.0-*`, `samples` and `sweeps`; or its `v1.0-*` folder, where there are several.
    pub data_root: PathBuf,
    /// Name or token; needed where there are several scenes.
    pub scene: Option<String>,
}

/// True for a folder that [`read_nuscenes`] can read.
pub fn is_nuscenes(path: &Path) -> bool {
    path.join("sample_data.json").is_file() || version_folders(path).is_ok_and(|v| !v.is_empty())
}

/// Reads a scene: camera images, LiDAR sweeps, ego poses and tracks.
///
/// Recordings between keyframes that are not on disk are left out with a note in the manifest.
///
/// # Errors
/// Names the table and row or the file that is missing or unusable.
pub fn read_nuscenes(inputs: &NuscenesInputs) -> Result<ReadLog> {
    let (root, folder) = locate(&inputs.data_root)?;
    let tables = Tables::new(folder);
    let scene = Scene::read(&tables, &root, inputs.scene.as_deref())?;
    let mut log = ReadLog::default();
    log.drive_log.dataset = "nuscenes".to_owned();
    sensors::add_cameras(&mut log, &root, &scene, &tables.path("calibrated_sensor"))?;
    sensors::add_sweeps(&mut log, &root, &scene)?;
    let mut notes = std::mem::take(&mut log.drive_log.notes);
    notes.insert(0, format!("scene {}", scene.name));
    if log.drive_log.frames.is_empty() {
        let what = format!("scene {} has no camera image", scene.name);
        return Err(Error::malformed(&tables.path("sample_data"), what));
    }
    let radars = scene.sensors.values().filter(|s| s.modality == "radar");
    let radars = radars.count();
    if radars > 0 {
        notes.push(format!("{radars} radars ignored"));
    }
    if scene.ego_poses.values().all(is_planar) {
        notes.push("ego poses are planar: without height, roll and pitch, slopes blur".to_owned());
    }
    log.drive_log.tracks = boxes::read(&tables, &scene, &mut notes)?;
    log.drive_log.notes = notes;
    let trajectory = Trajectory::new(scene.ego_poses);
    log.drive_log.local_from_world = Some(rigid_to_wire(&trajectory.local_from_world()));
    trajectory.record(&mut log.drive_log);
    Ok(log)
}

fn is_planar(pose: &Rigid) -> bool {
    pose.translation_m.z == 0.0 && (pose.direction(DVec3::Z) - DVec3::Z).length() < 1e-6
}

/// The data root and the folder of the tables.
fn locate(path: &Path) -> Result<(PathBuf, PathBuf)> {
    if path.join("sample_data.json").is_file() {
        // Canonical, so that the folder above "." is found too.
        let folder = path.canonicalize().map_err(|e| Error::io(path, e, ""))?;
        let root = folder.parent().map_or(folder.clone(), Path::to_owned);
        return Ok((root, folder));
    }
    let mut folders = version_folders(path).map_err(|e| Error::io(path, e, ""))?;
    match folders.len() {
        1 => Ok((path.to_owned(), folders.remove(0))),
        0 => Err(Error::Missing {
            path: path.join("v1.0-*/sample_data.json"),
            hint: "PATH must be a nuScenes folder with v1.0-*, samples and sweeps".to_owned(),
        }),
        _ => {
            let names: Vec<_> = folders.iter().map(|f| f.display().to_string()).collect();
            let what = format!("holds several versions: name one of {}", names.join(", "));
            Err(Error::choice(path, what))
        }
    }
}

fn version_folders(path: &Path) -> std::io::Result<Vec<PathBuf>> {
    let mut folders = Vec::new();
    for entry in std::fs::read_dir(path)? {
        let folder = entry?.path();
        let name = folder.file_name().and_then(|n| n.to_str()).unwrap_or("");
        if name.starts_with("v1.0-") && folder.join("sample_data.json").is_file() {
            folders.push(folder);
        }
    }
    folders.sort();
    Ok(folders)
}
