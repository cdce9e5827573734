//! Checks of a log on arrival: relations between its fields, then the content of its blobs.

use std::collections::BTreeSet;

use super::content::{self, LogBlobs};
use super::{Violations, movers};
use crate::domain::drive_log::{DriveLog, Track};

/// Limits on a manifest, so that no client makes the server hold an unbounded one.
const MAX_CAMERAS: usize = 64;
const MAX_FRAMES: usize = 50_000;
const MAX_SWEEPS: usize = 50_000;
const MAX_EGO_POSES: usize = 1_000_000;
/// Instance masks are 16 bits, with two values reserved.
const MAX_TRACKS: usize = 65_000;
const MAX_STATES: usize = 1_000_000;
/// Local coordinates beyond this lose millimetres in f32.
const MAX_LOCAL_M: f64 = 10_000.0;
/// No road user is larger.
const MAX_SIZE_M: f64 = 100.0;

/// What validation has to say about a log that can be used.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Accepted {
    /// Legal and probably not meant, e.g. a track that no camera sees.
    pub warnings: Vec<String>,
}

/// Checks a whole log; reads and decodes every blob, so it blocks for long.
///
/// # Errors
/// Outer: the blob store's own error. Inner: everything that is wrong with the log, by field. Content is looked at only
/// once the manifest itself is right.
pub fn validate<B: LogBlobs>(
    log: &DriveLog,
    blobs: &B,
) -> Result<Result<Accepted, Violations>, B::Error> {
    let mut violations = Violations::default();
    check_sizes(log, &mut violations);
    check_cameras(log, &mut violations);
    check_trajectory(log, &mut violations);
    check_frames(log, &mut violations);
    check_sweeps(log, &mut violations);
    check_tracks(log, &mut violations);
    if violations.is_empty() {
        content::check(log, blobs, &mut violations)?;
    }
    let accepted = Accepted {
        warnings: warnings(log),
    };
    Ok(violations.into_result(accepted))
}

fn check_sizes(log: &DriveLog, violations: &mut Violations) {
    let states = log.tracks.iter().map(|t| t.states.len()).sum();
    for (field, count, least, most) in [
        ("cameras", log.cameras.len(), 1, MAX_CAMERAS),
        ("frames", log.frames.len(), 1, MAX_FRAMES),
        ("sweeps", log.sweeps.len(), 0, MAX_SWEEPS),
        (
            "world_from_ego",
            log.world_from_ego.poses().len(),
            1,
            MAX_EGO_POSES,
        ),
        ("tracks", log.tracks.len(), 0, MAX_TRACKS),
        ("tracks.states", states, 0, MAX_STATES),
    ] {
        if count < least || count > most {
            violations.push(field, format!("has {count} entries, not {least} to {most}"));
        }
    }
}

fn check_cameras(log: &DriveLog, violations: &mut Violations) {
    let mut seen = BTreeSet::new();
    for (i, camera) in log.cameras.iter().enumerate() {
        let field = format!("cameras[{i}]");
        let who = format!("camera {}", camera.camera_id);
        if camera.camera_id.is_empty() {
            violations.push(format!("{field}.camera_id"), "is empty");
        } else if !seen.insert(&camera.camera_id) {
            violations.push(format!("{field}.camera_id"), format!("{who} is not unique"));
        }
        if let Err(error) = camera.camera.validate(&who) {
            violations.push(field, error.to_string());
        }
    }
}

fn check_trajectory(log: &DriveLog, violations: &mut Violations) {
    let poses = log.world_from_ego.poses();
    for (i, pair) in poses.windows(2).enumerate() {
        if pair[1].timestamp_ns <= pair[0].timestamp_ns {
            let what = format!(
                "{} is not after the pose before it, {}",
                pair[1].timestamp_ns, pair[0].timestamp_ns
            );
            violations.push(format!("world_from_ego[{}].timestamp_ns", i + 1), what);
        }
    }
    for (i, pose) in poses.iter().enumerate() {
        let local_m = log.local_from_world.point(pose.pose.translation_m).length();
        if local_m > MAX_LOCAL_M {
            let what = format!(
                "is {local_m:.0} m from the log's anchor, at most {MAX_LOCAL_M:.0} m are accepted: choose local_from_world near the drive"
            );
            violations.push(format!("world_from_ego[{i}].translation_m"), what);
            return;
        }
    }
}

fn check_frames(log: &DriveLog, violations: &mut Violations) {
    let mut seen = BTreeSet::new();
    for (i, frame) in log.frames.iter().enumerate() {
        let who = format!("(camera {}, frame {})", frame.camera_id, frame.frame_index);
        if log.camera(&frame.camera_id).is_none() {
            let what = format!("{who} names no camera of the log");
            violations.push(format!("frames[{i}].camera_id"), what);
        }
        if !seen.insert((&frame.camera_id, frame.frame_index)) {
            let what = format!("{who} is not unique in its camera");
            violations.push(format!("frames[{i}].frame_index"), what);
        }
        if let Some(what) = uncovered(log, frame.timestamp_ns) {
            violations.push(format!("frames[{i}].timestamp_ns"), format!("{who} {what}"));
        }
        if frame.instance_mask.is_some() && frame.free_instance_mask.is_some() {
            let what = format!("{who} stands beside instance_mask: bring one of them");
            violations.push(format!("frames[{i}].free_instance_mask"), what);
        }
    }
}

fn check_sweeps(log: &DriveLog, violations: &mut Violations) {
    for (i, sweep) in log.sweeps.iter().enumerate() {
        if let Some(what) = uncovered(log, sweep.timestamp_ns) {
            let what = format!("(lidar {}) {what}", sweep.lidar_id);
            violations.push(format!("sweeps[{i}].timestamp_ns"), what);
        }
    }
}

fn uncovered(log: &DriveLog, timestamp_ns: i64) -> Option<String> {
    let (first, last) = log.world_from_ego.span_ns()?;
    (timestamp_ns < first || timestamp_ns > last)
        .then(|| format!("{timestamp_ns} is outside the ego trajectory, {first} to {last}"))
}

fn check_tracks(log: &DriveLog, violations: &mut Violations) {
    let mut seen = BTreeSet::new();
    for (i, track) in log.tracks.iter().enumerate() {
        let who = format!("(track {})", track.track_id);
        if track.track_id.is_empty() || !seen.insert(&track.track_id) {
            let what = format!("{who} is empty or not unique");
            violations.push(format!("tracks[{i}].track_id"), what);
        }
        let size = track.size_m;
        if !(size.min_element() > 0.0 && size.max_element() <= MAX_SIZE_M) {
            let what = format!("{who} {size} is not within 0 to {MAX_SIZE_M} m");
            violations.push(format!("tracks[{i}].size_m"), what);
        }
        if track.states.is_empty() {
            violations.push(format!("tracks[{i}].states"), format!("{who} is empty"));
        }
        check_states(i, track, violations);
    }
}

fn check_states(i: usize, track: &Track, violations: &mut Violations) {
    for (j, pair) in track.states.windows(2).enumerate() {
        if pair[1].timestamp_ns <= pair[0].timestamp_ns {
            let what = format!(
                "(track {}) {} is not after the state before it, {}",
                track.track_id, pair[1].timestamp_ns, pair[0].timestamp_ns
            );
            let field = format!("tracks[{i}].states[{}].timestamp_ns", j + 1);
            violations.push(field, what);
        }
    }
}

fn depth_without_lidar(log: &DriveLog) -> &'static str {
    let has_maps = log.frames.iter().any(|f| f.depth_map.is_some());
    match (has_maps, log.sfm_points.is_some()) {
        (true, false) => "the log has no LiDAR: depth is that of its depth maps",
        (false, true) => "the log has no LiDAR: depth is that of its SfM points",
        (true, true) => "the log has no LiDAR: depth is that of its depth maps and SfM points",
        (false, false) => {
            "the log has no LiDAR, depth map or SfM point: fields are trained without depth"
        }
    }
}

/// Tracks named in one warning.
const MAX_NAMED: usize = 5;

fn warnings(log: &DriveLog) -> Vec<String> {
    let mut warnings = Vec::new();
    if log.sweeps.is_empty() {
        warnings.push(depth_without_lidar(log).to_owned());
    }
    if log.frames.iter().any(|f| f.readout_ns > 0) {
        warnings.push("rolling shutter: each image is used with the pose of its middle row".into());
    }
    let unseen: Vec<&str> = log
        .tracks
        .iter()
        .filter(|track| !movers::is_in_any_frame(log, track))
        .map(|track| track.track_id.as_str())
        .collect();
    if !unseen.is_empty() {
        let named = unseen[..unseen.len().min(MAX_NAMED)].join(", ");
        let more = unseen.len().saturating_sub(MAX_NAMED);
        let more = if more > 0 {
            format!(" and {more} more")
        } else {
            String::new()
        };
        warnings.push(format!("no camera sees track {named}{more}"));
    }
    warnings
}
