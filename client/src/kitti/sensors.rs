//! Images and sweeps of a drive.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use backlot_engine::camera::Rigid;
use backlot_proto::v1;
use rayon::prelude::*;

use super::calibration::Calibration;
use super::clock::Clock;
use super::drive;
use crate::geometry::rigid_to_wire;
use crate::read_log::{Error, Result};
use crate::read_log::{ReadLog, content};

pub(super) const CAMERA_ID: &str = "image_02";
const LIDAR_ID: &str = "velodyne";
/// What says how large the images are.
const SIZE_SOURCE: &str = "the calibration";

/// Images of the left colour camera by frame; at least one. `hint` says where they should be.
pub(super) fn image_files(folder: &Path, hint: &str) -> Result<BTreeMap<u32, PathBuf>> {
    let images = drive::frame_files(folder, &["png", "jpg", "jpeg"])?;
    if images.is_empty() {
        return Err(Error::Missing {
            path: folder.join("*.png"),
            hint: hint.to_owned(),
        });
    }
    Ok(images)
}

/// Time of every frame that has an image; `clock` is from the file `timestamps`.
pub(super) fn frame_times(
    timestamps: &Path,
    images: &BTreeMap<u32, PathBuf>,
    clock: &Clock,
) -> Result<BTreeMap<u32, i64>> {
    images
        .keys()
        .map(|&frame| {
            let what = || format!("no line for frame {frame}, which has an image");
            let time = clock
                .at(frame)
                .ok_or_else(|| Error::malformed(timestamps, what()))?;
            Ok((frame, time))
        })
        .collect()
}

/// Checks the images and adds them to the log.
pub(super) fn add_frames(
    log: &mut ReadLog,
    images: &BTreeMap<u32, PathBuf>,
    frames: &BTreeMap<u32, i64>,
    calibration: &Calibration,
) -> Result<()> {
    let size = (calibration.camera.width, calibration.camera.height);
    let checked: Vec<_> = images
        .par_iter()
        .map(|(&frame, path)| Ok((frame, path, content::check_image(path, size, SIZE_SOURCE)?)))
        .collect::<Result<_>>()?;
    for (frame_index, path, image) in checked {
        log.add_file(path, &image);
        log.drive_log.frames.push(v1::CameraFrame {
            camera_id: CAMERA_ID.to_owned(),
            frame_index,
            timestamp_ns: frames[&frame_index],
            image: Some(image),
            ..Default::default()
        });
    }
    Ok(())
}

/// Checks the sweeps of the given frames in a folder and adds them to the log.
pub(super) fn add_sweeps(
    log: &mut ReadLog,
    folder: &Path,
    clock: &Clock,
    frames: &BTreeMap<u32, i64>,
    notes: &mut Vec<String>,
) -> Result<()> {
    let files = drive::frame_files(folder, &["bin"])?;
    let unused = files.keys().filter(|f| !frames.contains_key(f)).count();
    if unused > 0 {
        notes.push(format!(
            "{unused} sweeps of frames without an image ignored"
        ));
    }
    let missing = frames.keys().filter(|f| !files.contains_key(f)).count();
    if missing > 0 {
        notes.push(format!("{missing} frames have no Velodyne sweep"));
    }
    let checked: Vec<_> = files
        .par_iter()
        .filter_map(|(frame, path)| Some((*frame, *frames.get(frame)?, path)))
        .map(|(frame, image_time, path)| Ok((frame, image_time, path, drive::check_sweep(path)?)))
        .collect::<Result<_>>()?;
    for (frame, image_time, path, points) in checked {
        log.add_file(path, &points);
        let timestamp_ns = match clock {
            Clock::Assumed => image_time,
            Clock::Read(_) => clock.at(frame).unwrap_or(image_time),
        };
        log.drive_log.sweeps.push(v1::LidarSweep {
            lidar_id: LIDAR_ID.to_owned(),
            timestamp_ns,
            ego_from_lidar: Some(rigid_to_wire(&Rigid::IDENTITY)),
            points: Some(points),
            format: v1::PointFormat::XyziF32.into(),
        });
    }
    Ok(())
}
