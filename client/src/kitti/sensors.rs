//! Images and sweeps of a drive.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use backlot_engine::camera::Rigid;
use backlot_proto::v1;
use rayon::prelude::*;

use super::calibration::Calibration;
use super::clock::Clock;
use super::drive;
use super::error::{Error, Result};
use crate::geometry::rigid_to_wire;
use crate::read_log::{BlobSource, ReadLog};

pub(super) const CAMERA_ID: &str = "image_02";
const LIDAR_ID: &str = "velodyne";

/// Images of the left colour camera by frame; at least one.
pub(super) fn image_files(drive: &Path) -> Result<BTreeMap<u32, PathBuf>> {
    let folder = drive.join("image_02/data");
    let images = drive::frame_files(&folder, &["png", "jpg", "jpeg"])?;
    if images.is_empty() {
        let hint = "PATH must be a KITTI raw drive folder (..._sync) with images in image_02/data";
        return Err(Error::Missing {
            path: folder.join("*.png"),
            hint: hint.to_owned(),
        });
    }
    Ok(images)
}

/// Time of every frame that has an image.
pub(super) fn frame_times(
    drive: &Path,
    images: &BTreeMap<u32, PathBuf>,
    clock: &Clock,
) -> Result<BTreeMap<u32, i64>> {
    images
        .keys()
        .map(|&frame| {
            let what = || format!("no line for frame {frame}, which has an image");
            let path = drive.join("image_02/timestamps.txt");
            let time = clock
                .at(frame)
                .ok_or_else(|| Error::malformed(&path, what()))?;
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
    let (width, height) = (calibration.camera.width, calibration.camera.height);
    let checked: Vec<_> = images
        .par_iter()
        .map(|(&frame, path)| Ok((frame, path, drive::check_image(path, width, height)?)))
        .collect::<Result<_>>()?;
    for (frame_index, path, image) in checked {
        log.blobs
            .insert(image.digest.clone(), BlobSource::File(path.clone()));
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

/// Checks the sweeps of the given frames and adds them to the log.
pub(super) fn add_sweeps(
    log: &mut ReadLog,
    drive: &Path,
    frames: &BTreeMap<u32, i64>,
    notes: &mut Vec<String>,
) -> Result<()> {
    let sensor = drive.join("velodyne_points");
    let files = drive::frame_files(&sensor.join("data"), &["bin"])?;
    let clock = Clock::read(&sensor)?;
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
        log.blobs
            .insert(points.digest.clone(), BlobSource::File(path.clone()));
        let timestamp_ns = match &clock {
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
