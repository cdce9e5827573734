//! Checks of what the blobs of a log contain.

use bytes::Bytes;

use super::Violations;
use super::image::{ImageError, decode_instance_mask, decode_rgb, decode_sky_mask};
use super::points::decode_points;
use crate::domain::blob::BlobRef;
use crate::domain::drive_log::{CameraFrame, DriveLog, LidarSweep, MASK_NONE, MASK_UNKNOWN};

/// The blobs of a log being checked. Calls may block.
pub trait LogBlobs {
    type Error;

    /// Size in bytes of a complete blob; `None` if it is not there.
    fn size_bytes(&self, blob: &BlobRef) -> Result<Option<u64>, Self::Error>;

    /// A complete blob's content.
    fn read(&self, blob: &BlobRef) -> Result<Bytes, Self::Error>;
}

/// Largest image, mask or sweep file; one is held in memory at a time.
const MAX_FILE_BYTES: u64 = 256 << 20;

/// Checks that every blob is there, decodes and fits the manifest.
///
/// # Errors
/// The blob store's own error; what is wrong with the log goes to `violations`.
pub(super) fn check<B: LogBlobs>(
    log: &DriveLog,
    blobs: &B,
    violations: &mut Violations,
) -> Result<(), B::Error> {
    for (i, frame) in log.frames.iter().enumerate() {
        check_frame(log, i, frame, blobs, violations)?;
    }
    for (i, sweep) in log.sweeps.iter().enumerate() {
        if let Some(what) = problem_of(&sweep.points, blobs, |b| sweep_problem(sweep, b))? {
            let what = format!("(lidar {}) {what}", sweep.lidar_id);
            violations.push(format!("sweeps[{i}].points"), what);
        }
    }
    Ok(())
}

fn check_frame<B: LogBlobs>(
    log: &DriveLog,
    i: usize,
    frame: &CameraFrame,
    blobs: &B,
    violations: &mut Violations,
) -> Result<(), B::Error> {
    let Some(camera) = log.camera(&frame.camera_id) else {
        return Ok(());
    };
    let size = (camera.camera.width, camera.camera.height);
    let mut report = |field: &str, problem: Option<String>| {
        if let Some(what) = problem {
            let who = format!("camera {}, frame {}", frame.camera_id, frame.frame_index);
            violations.push(format!("frames[{i}].{field}"), format!("({who}) {what}"));
        }
    };
    let of_image = problem_of(&frame.image, blobs, |b| {
        problem("image", decode_rgb(b, size))
    })?;
    report("image", of_image);
    if let Some(mask) = &frame.instance_mask {
        let of_mask = problem_of(mask, blobs, |b| {
            instance_mask_problem(b, size, log.tracks.len())
        })?;
        report("instance_mask", of_mask);
    }
    if let Some(mask) = &frame.sky_mask {
        let of_mask = problem_of(mask, blobs, |b| problem("mask", decode_sky_mask(b, size)))?;
        report("sky_mask", of_mask);
    }
    Ok(())
}

/// What is wrong with a blob: its presence, its size, then its content.
fn problem_of<B: LogBlobs>(
    blob: &BlobRef,
    blobs: &B,
    content: impl FnOnce(&[u8]) -> Option<String>,
) -> Result<Option<String>, B::Error> {
    Ok(match blobs.size_bytes(blob)? {
        None => Some(format!("blob {} was not uploaded completely", blob.digest)),
        Some(held) if held != blob.size_bytes => Some(format!(
            "blob {} has {held} bytes, not {}",
            blob.digest, blob.size_bytes
        )),
        Some(held) if held > MAX_FILE_BYTES => Some(format!(
            "has {held} bytes, at most {MAX_FILE_BYTES} are accepted"
        )),
        Some(_) => content(&blobs.read(blob)?),
    })
}

fn problem<T>(what: &str, decoded: Result<T, ImageError>) -> Option<String> {
    decoded.err().map(|error| format!("{what} {error}"))
}

fn instance_mask_problem(bytes: &[u8], size: (u32, u32), track_count: usize) -> Option<String> {
    let mask = match decode_instance_mask(bytes, size) {
        Ok(mask) => mask,
        Err(error) => return Some(format!("mask {error}")),
    };
    let is_known = |&v: &u16| v == MASK_NONE || v == MASK_UNKNOWN || usize::from(v) <= track_count;
    let at = mask.iter().position(|v| !is_known(v))?;
    let (x, y) = (at as u32 % size.0, at as u32 / size.0);
    Some(format!(
        "mask value {} at pixel ({x}, {y}) names no track, the log has {track_count}",
        mask[at]
    ))
}

fn sweep_problem(sweep: &LidarSweep, bytes: &[u8]) -> Option<String> {
    let point_bytes = sweep.format.point_bytes();
    if !bytes.len().is_multiple_of(point_bytes) {
        return Some(format!(
            "sweep of {} bytes is cut off: points have {point_bytes} bytes each",
            bytes.len()
        ));
    }
    let has_points = decode_points(bytes, sweep.format).next().is_some();
    (!has_points).then(|| "sweep has no usable point".to_owned())
}
