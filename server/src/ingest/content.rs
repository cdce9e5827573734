//! Checks of what the blobs of a log contain.

use bytes::Bytes;
use rayon::prelude::*;

use super::Violations;
use super::free_masks::{MAX_FREE_INSTANCES, instances};
use super::image::{
    ImageError, decode_depth_map, decode_instance_mask, decode_rgb, decode_sky_mask,
};
use super::points::decode_points;
use super::sfm::{Observation, decode_observations, decode_sfm_points};
use crate::domain::blob::BlobRef;
use crate::domain::drive_log::{
    CameraFrame, DEPTH_UNKNOWN, DriveLog, LidarSweep, MASK_NONE, MASK_UNKNOWN, OBSERVATION_BYTES,
    SFM_POINT_BYTES, SfmPoints,
};

/// The blobs of a log being checked. Calls may block.
pub trait LogBlobs: Sync {
    type Error: Send;

    /// Size in bytes of a complete blob; `None` if it is not there.
    fn size_bytes(&self, blob: &BlobRef) -> Result<Option<u64>, Self::Error>;

    /// A complete blob's content.
    fn read(&self, blob: &BlobRef) -> Result<Bytes, Self::Error>;

    /// Size in pixels of a complete blob that was decoded as an image before; `None` if it was not, or did not decode.
    fn decoded_size(&self, blob: &BlobRef) -> Option<(u32, u32)> {
        let _ = blob;
        None
    }
}

/// Largest image, mask, sweep or point file.
pub(super) const MAX_FILE_BYTES: u64 = 256 << 20;
/// Frames or sweeps checked at once, each on a thread: that many files and decoded images are held in memory.
const CHECKED_AT_ONCE: usize = 4;
/// Ten times what a drive of a thousand images triangulates to; all are held in memory.
const MAX_SFM_POINTS: usize = 2_000_000;

/// Checks that every blob is there, decodes and fits the manifest.
///
/// # Errors
/// The blob store's own error; what is wrong with the log goes to `violations`.
pub(super) fn check<B: LogBlobs>(
    log: &DriveLog,
    blobs: &B,
    violations: &mut Violations,
) -> Result<(), B::Error> {
    each(log.frames.len(), violations, |i, found| {
        check_frame(log, i, &log.frames[i], blobs, found)
    })?;
    each(log.sweeps.len(), violations, |i, found| {
        let sweep = &log.sweeps[i];
        if let Some(what) = problem_of(&sweep.points, blobs, |b| sweep_problem(sweep, b))? {
            let what = format!("(lidar {}) {what}", sweep.lidar_id);
            found.push(format!("sweeps[{i}].points"), what);
        }
        Ok(())
    })?;
    if let Some(sfm) = &log.sfm_points {
        check_sfm(log, sfm, blobs, violations)?;
    }
    Ok(())
}

/// Runs `check` for every index, some at a time, and keeps what it finds in order.
fn each<E: Send>(
    count: usize,
    violations: &mut Violations,
    check: impl Fn(usize, &mut Violations) -> Result<(), E> + Sync,
) -> Result<(), E> {
    let indices: Vec<usize> = (0..count).collect();
    for together in indices.chunks(CHECKED_AT_ONCE) {
        let found: Vec<Violations> = together
            .par_iter()
            .map(|&i| {
                let mut found = Violations::default();
                check(i, &mut found).map(|()| found)
            })
            .collect::<Result<_, E>>()?;
        found.into_iter().for_each(|f| violations.append(f));
    }
    Ok(())
}

fn check_sfm<B: LogBlobs>(
    log: &DriveLog,
    sfm: &SfmPoints,
    blobs: &B,
    violations: &mut Violations,
) -> Result<(), B::Error> {
    if let Some(what) = problem_of(&sfm.points, blobs, sfm_problem)? {
        violations.push("sfm_points.points", what);
    }
    if let Some(observations) = &sfm.observations {
        let points = sfm.points.size_bytes / SFM_POINT_BYTES as u64;
        let frames = log.frames.len();
        let of_observations = problem_of(observations, blobs, |b| {
            observations_problem(b, points, frames)
        })?;
        if let Some(what) = of_observations {
            violations.push("sfm_points.observations", what);
        }
    }
    Ok(())
}

fn sfm_problem(bytes: &[u8]) -> Option<String> {
    let count = bytes.len() / SFM_POINT_BYTES;
    if !bytes.len().is_multiple_of(SFM_POINT_BYTES) {
        let what = format!(
            "{} bytes are cut off: points have {SFM_POINT_BYTES} bytes each",
            bytes.len()
        );
        return Some(what);
    }
    if count == 0 {
        return Some("has no point: leave sfm_points out".to_owned());
    }
    if count > MAX_SFM_POINTS {
        let what = format!("has {count} points, at most {MAX_SFM_POINTS} are accepted");
        return Some(what);
    }
    let (number, point) = decode_sfm_points(bytes)
        .enumerate()
        .find(|(_, p)| !p.is_finite())?;
    Some(format!("point {number} is {point}, not finite"))
}

fn observations_problem(bytes: &[u8], points: u64, frames: usize) -> Option<String> {
    if !bytes.len().is_multiple_of(OBSERVATION_BYTES) {
        return Some(format!(
            "{} bytes are cut off: observations have {OBSERVATION_BYTES} bytes each",
            bytes.len()
        ));
    }
    if bytes.is_empty() {
        return Some("has no observation: leave it out".to_owned());
    }
    let is_known = |o: &Observation| u64::from(o.point) < points && (o.frame as usize) < frames;
    let (number, seen) = decode_observations(bytes)
        .enumerate()
        .find(|(_, o)| !is_known(o))?;
    Some(format!(
        "observation {number} names point {} and frame {}, the log has {points} points and {frames} frames",
        seen.point, seen.frame
    ))
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
    let of_depth = match &frame.depth_map {
        Some(map) => problem_of(&map.image, blobs, |b| depth_map_problem(b, size))?,
        None => None,
    };
    report("depth_map.image", of_depth);
    let of_image = match blobs.decoded_size(&frame.image) {
        Some(known) if known == size => problem_of_size(&frame.image, blobs)?,
        _ => problem_of(&frame.image, blobs, |b| {
            problem("image", decode_rgb(b, size))
        })?,
    };
    report("image", of_image);
    if let Some(mask) = &frame.instance_mask {
        let of_mask = problem_of(mask, blobs, |b| {
            instance_mask_problem(b, size, log.tracks.len())
        })?;
        report("instance_mask", of_mask);
    }
    if let Some(mask) = &frame.free_instance_mask {
        let of_mask = problem_of(mask, blobs, |b| free_mask_problem(b, size))?;
        report("free_instance_mask", of_mask);
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
    match problem_of_size(blob, blobs)? {
        None => Ok(content(&blobs.read(blob)?)),
        found => Ok(found),
    }
}

fn problem_of_size<B: LogBlobs>(blob: &BlobRef, blobs: &B) -> Result<Option<String>, B::Error> {
    Ok(match blobs.size_bytes(blob)? {
        None => Some(format!("blob {} was not uploaded completely", blob.digest)),
        Some(held) if held != blob.size_bytes => Some(format!(
            "blob {} has {held} bytes, not {}",
            blob.digest, blob.size_bytes
        )),
        Some(held) if held > MAX_FILE_BYTES => Some(format!(
            "has {held} bytes, at most {MAX_FILE_BYTES} are accepted"
        )),
        Some(_) => None,
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

fn depth_map_problem(bytes: &[u8], size: (u32, u32)) -> Option<String> {
    match decode_depth_map(bytes, size) {
        Err(error) => Some(format!("depth map {error}")),
        Ok(units) if units.iter().all(|&u| u == DEPTH_UNKNOWN) => {
            Some("depth map has no known pixel: leave it out".to_owned())
        }
        Ok(_) => None,
    }
}

fn free_mask_problem(bytes: &[u8], size: (u32, u32)) -> Option<String> {
    match decode_instance_mask(bytes, size) {
        Err(error) => Some(format!("mask {error}")),
        Ok(mask) => {
            let count = instances(&mask).len();
            (count > MAX_FREE_INSTANCES).then(|| {
                format!("mask has {count} instances, at most {MAX_FREE_INSTANCES} are accepted")
            })
        }
    }
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
