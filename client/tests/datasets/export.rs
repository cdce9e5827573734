//! Data sets for other readers, with the corners that ours sees: `read_by_others.py` compares.

use std::fs;
use std::path::{Path, PathBuf};

use backlot_client::argoverse::{ArgoverseInputs, read_argoverse};
use backlot_client::motion::track_pose_at;
use backlot_client::nuscenes::{NuscenesInputs, read_nuscenes};
use backlot_client::read_log::ReadLog;
use serde_json::{Value, json};

use crate::argoverse_files;
use crate::nuscenes_files;
use crate::same_log::corners_px;
use crate::street::street;

/// Below the build's folder for such files.
fn fresh_folder(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR"))
        .join("datasets")
        .join(name);
    if folder.exists() {
        fs::remove_dir_all(&folder).expect("the old files can go");
    }
    fs::create_dir_all(&folder).expect("the folder is writable");
    folder
}

/// The corners of every box in every image at its labelled times and at the image's own, as this crate's readers see them.
fn corners(log: &ReadLog) -> Value {
    let log = &log.drive_log;
    let mut boxes = Vec::new();
    for frame in &log.frames {
        let camera = log.cameras.iter().find(|c| c.camera_id == frame.camera_id);
        let camera = camera.expect("a frame has a camera");
        for track in &log.tracks {
            let labelled = track.states.iter().map(|state| state.timestamp_ns);
            for at in labelled.chain([frame.timestamp_ns]) {
                let Some(pose) = track_pose_at(track, at) else {
                    continue;
                };
                let corners = corners_px(log, camera, track, &pose, frame.timestamp_ns);
                let pixels: Vec<_> = corners.iter().map(|c| c.map(|p| p.to_array())).collect();
                boxes.push(json!({"camera": frame.camera_id, "image_ns": frame.timestamp_ns, "track": track.track_id,
                    "box_ns": at, "corners": pixels}));
            }
        }
    }
    Value::Array(boxes)
}

fn put_corners(folder: &Path, log: &ReadLog) {
    let text = serde_json::to_string(&corners(log)).expect("corners are JSON");
    fs::write(folder.join("corners.json"), text).expect("the file is writable");
}

#[test]
fn nuscenes_for_other_readers() {
    let folder = fresh_folder("nuscenes");
    nuscenes_files::write(&street(), &folder);
    let inputs = NuscenesInputs {
        data_root: folder.clone(),
        scene: None,
    };
    put_corners(&folder, &read_nuscenes(&inputs).expect("the log reads"));
}

#[test]
fn argoverse_for_other_readers() {
    let folder = fresh_folder("argoverse");
    argoverse_files::write(&street(), &folder);
    let inputs = ArgoverseInputs {
        path: folder.clone(),
        log: None,
    };
    put_corners(&folder, &read_argoverse(&inputs).expect("the log reads"));
}
