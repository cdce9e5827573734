//! Cameras and images of a segment.

use std::collections::BTreeMap;
use std::path::Path;

use backlot_engine::camera::{Camera, Distortion, Rigid};
use backlot_proto::v1;
use bytes::Bytes;
use glam::{DMat3, DQuat, DVec2, DVec3};
use rayon::prelude::*;

use super::table::{Row, Table};
use super::transform::{rigid, time_of_seconds};
use crate::geometry::camera_to_wire;
use crate::read_log::content::{check_header, time_of_micros};
use crate::read_log::{ReadLog, Result, SpoolWriter};

pub(super) const FRAME_TIME: &str = "key.frame_timestamp_micros";
pub(super) const CAMERA: &str = "key.camera_name";
const IMAGE: &str = "[CameraImageComponent].image";
const POSE: &str = "[CameraImageComponent].pose.transform";
const POSE_TIME: &str = "[CameraImageComponent].pose_timestamp";
const SHUTTER: &str = "[CameraImageComponent].rolling_shutter_params.shutter";
const TRIGGER: &str = "[CameraImageComponent].rolling_shutter_params.camera_trigger_time";
const READ_OUT: &str = "[CameraImageComponent].rolling_shutter_params.camera_readout_done_time";
/// Images checked at once; each is held in memory while it is.
const BATCH: usize = 16;

/// Time of the segment's frame in nanoseconds, and number of the camera.
pub(super) type FrameKey = (i64, i64);

/// A camera of the segment.
#[derive(Clone, Debug)]
struct SegmentCamera {
    name: String,
    model: Camera,
    readout: v1::ReadoutDirection,
    /// A global shutter has no readout time.
    is_global: bool,
}

/// Adds cameras and images, and returns the key of each; the poses of the vehicle at the images' times go to `poses`.
pub(super) fn add_cameras(
    log: &mut ReadLog,
    spool: &mut SpoolWriter,
    root: &Path,
    segment: &str,
    poses: &mut BTreeMap<i64, Rigid>,
) -> Result<Vec<FrameKey>> {
    let cameras = read_calibration(log, root, segment)?;
    let table = Table::required(root, "camera_image", segment)?;
    let names = [
        FRAME_TIME, CAMERA, IMAGE, POSE, POSE_TIME, SHUTTER, TRIGGER, READ_OUT,
    ];
    let mut rows = table.rows(&names, &[SHUTTER, TRIGGER, READ_OUT])?;
    let mut frames = Vec::new();
    loop {
        let mut batch = Vec::with_capacity(BATCH);
        while batch.len() < BATCH
            && let Some(row) = rows.next_row()?
        {
            let number = row.integer(CAMERA)?;
            let camera = cameras.get(&number);
            let camera =
                camera.ok_or_else(|| row.bad(format!("camera {number} has no calibration")))?;
            let pose = rigid(&row.array(POSE)?).map_err(|e| row.bad(e))?;
            let pose_time = time_of_seconds(row.number(POSE_TIME)?).map_err(|e| row.bad(e))?;
            poses.entry(pose_time).or_insert(pose);
            let frame = frame(&row, camera, pose_time)?;
            batch.push((row, camera, (frame.0, number), frame.1));
        }
        if batch.is_empty() {
            break;
        }
        let checked: Vec<Bytes> = batch
            .par_iter()
            .map(|(row, camera, ..)| check_image(row, camera))
            .collect::<Result<_>>()?;
        for ((row, _, key, mut frame), image) in batch.into_iter().zip(checked) {
            let blob = log.add_spooled(spool, &image).map_err(|e| row.bad(e))?;
            frame.image = Some(blob);
            frames.push((key, frame));
        }
    }
    number_frames(&mut frames);
    let (keys, frames) = frames.into_iter().unzip();
    log.drive_log.frames = frames;
    Ok(keys)
}

fn check_image(row: &Row<'_>, camera: &SegmentCamera) -> Result<Bytes> {
    let image = row.bytes(IMAGE)?;
    let size = (camera.model.width, camera.model.height);
    let named = |what| row.bad(format!("image of {}: {what}", camera.name));
    check_header(image, size, "camera_calibration").map_err(named)?;
    Ok(image.clone())
}

/// Images are numbered by the frame of the segment they belong to.
fn number_frames(frames: &mut [(FrameKey, v1::CameraFrame)]) {
    let mut times: Vec<i64> = frames.iter().map(|((time, _), _)| *time).collect();
    times.sort_unstable();
    times.dedup();
    for ((time, _), frame) in frames.iter_mut() {
        frame.frame_index = times.partition_point(|t| t < time) as u32;
    }
    frames.sort_by(|(_, a), (_, b)| {
        (&a.camera_id, a.timestamp_ns).cmp(&(&b.camera_id, b.timestamp_ns))
    });
}

/// The time of the segment's frame, and the image's entry without its blob.
fn frame(row: &Row<'_>, camera: &SegmentCamera, pose_time: i64) -> Result<(i64, v1::CameraFrame)> {
    let frame_time = time_of_micros(row.integer(FRAME_TIME)?).map_err(|e| row.bad(e))?;
    let mut frame = v1::CameraFrame {
        camera_id: camera.name.clone(),
        timestamp_ns: pose_time,
        readout_direction: camera.readout.into(),
        ..Default::default()
    };
    let known = |name| Ok(row.numbers(name)?.first().copied().filter(|&v| v > 0.0));
    if let (Some(shutter), Some(trigger), Some(read_out)) =
        (known(SHUTTER)?, known(TRIGGER)?, known(READ_OUT)?)
    {
        let [start, end] = [trigger, read_out].map(time_of_seconds);
        let (start, end) = (start.map_err(|e| row.bad(e))?, end.map_err(|e| row.bad(e))?);
        let exposure_ns = time_of_seconds(shutter).map_err(|e| row.bad(e))?;
        if end < start || exposure_ns > end - start {
            return Err(row.bad(format!(
                "read out at {read_out} s, before trigger and shutter end"
            )));
        }
        // The first line is exposed from the trigger on, the last one until the readout is done; in between is the middle.
        frame.timestamp_ns = start + (end - start) / 2;
        frame.exposure_ns = exposure_ns;
        frame.readout_ns = if camera.is_global {
            0
        } else {
            end - start - exposure_ns
        };
    }
    Ok((frame_time, frame))
}

/// Reads the cameras by their number and adds them to the log.
fn read_calibration(
    log: &mut ReadLog,
    root: &Path,
    segment: &str,
) -> Result<BTreeMap<i64, SegmentCamera>> {
    const EXTRINSIC: &str = "[CameraCalibrationComponent].extrinsic.transform";
    const WIDTH: &str = "[CameraCalibrationComponent].width";
    const HEIGHT: &str = "[CameraCalibrationComponent].height";
    const DIRECTION: &str = "[CameraCalibrationComponent].rolling_shutter_direction";
    let intrinsic = ["f_u", "f_v", "c_u", "c_v", "k1", "k2", "p1", "p2", "k3"]
        .map(|name| format!("[CameraCalibrationComponent].intrinsic.{name}"));
    let table = Table::required(root, "camera_calibration", segment)?;
    let mut names = vec![CAMERA, EXTRINSIC, WIDTH, HEIGHT, DIRECTION];
    names.extend(intrinsic.iter().map(String::as_str));
    let mut cameras = BTreeMap::new();
    let mut rows = table.rows(&names, &[])?;
    while let Some(row) = rows.next_row()? {
        let number = row.integer(CAMERA)?;
        let mut values = [0.0; 9];
        for (value, name) in values.iter_mut().zip(&intrinsic) {
            *value = row.number(name)?;
        }
        let pixels = |name| Ok(u32::try_from(row.integer(name)?).unwrap_or(0));
        let name = camera_name(number);
        let model = camera_model(values, pixels(WIDTH)?, pixels(HEIGHT)?);
        model.validate(&name).map_err(|e| row.bad(e))?;
        let vehicle_from_camera = rigid(&row.array(EXTRINSIC)?).map_err(|e| row.bad(e))?;
        let wire = camera_to_wire(
            &name,
            &model,
            &(vehicle_from_camera * forward_from_opencv()),
        );
        log.drive_log.cameras.push(wire);
        let direction = row.integer(DIRECTION)?;
        let camera = SegmentCamera {
            name,
            model,
            readout: readout_direction(direction),
            is_global: direction == 5,
        };
        if cameras.insert(number, camera).is_some() {
            return Err(row.bad(format!("camera {number} has a second calibration")));
        }
    }
    log.drive_log
        .cameras
        .sort_by(|a, b| a.camera_id.cmp(&b.camera_id));
    Ok(cameras)
}

/// Pixel coordinates start at the corner of the first pixel, as in the manifest.
fn camera_model(intrinsic: [f64; 9], width: u32, height: u32) -> Camera {
    let [fx, fy, cx, cy, k @ ..] = intrinsic;
    Camera {
        width,
        height,
        focal_px: DVec2::new(fx, fy),
        principal_px: DVec2::new(cx, cy),
        distortion: if k == [0.0; 5] {
            Distortion::None
        } else {
            Distortion::BrownConrady { k }
        },
    }
}

/// The data set's cameras look along x, with y left and z up.
fn forward_from_opencv() -> Rigid {
    let axes = DMat3::from_cols(DVec3::NEG_Y, DVec3::NEG_Z, DVec3::X);
    Rigid::new(DQuat::from_mat3(&axes), DVec3::ZERO)
}

fn camera_name(number: i64) -> String {
    const NAMES: [&str; 9] = [
        "UNKNOWN",
        "FRONT",
        "FRONT_LEFT",
        "FRONT_RIGHT",
        "SIDE_LEFT",
        "SIDE_RIGHT",
        "REAR_LEFT",
        "REAR",
        "REAR_RIGHT",
    ];
    let name = usize::try_from(number).ok().and_then(|i| NAMES.get(i));
    name.map_or_else(|| format!("CAMERA_{number}"), |name| (*name).to_owned())
}

fn readout_direction(number: i64) -> v1::ReadoutDirection {
    match number {
        1 => v1::ReadoutDirection::TopToBottom,
        2 => v1::ReadoutDirection::LeftToRight,
        3 => v1::ReadoutDirection::BottomToTop,
        4 => v1::ReadoutDirection::RightToLeft,
        _ => v1::ReadoutDirection::Unspecified,
    }
}
