//! Figures of a log: cameras, sweeps, tracks, distances, and what is missing.

use std::collections::BTreeMap;

use backlot_engine::camera::Rigid;
use backlot_proto::v1;
use glam::DVec2;
use serde::Serialize;

use super::depth::{DepthReport, depth_reports};
use crate::geometry::{camera_from_wire, rigid_from_wire, vector_from_wire};
use crate::motion::{ego_pose_at, track_pose_at};

/// An image further from every sweep than this has no LiDAR of its own: scanners turn ten or twenty times a second.
const SWEEP_REACH_NS: u64 = 100_000_000;
/// A cuboid that goes further than this in the world moves; annotations of parked cars jitter.
const MOVING_M: f64 = 1.0;
/// States further apart than this leave a gap: data sets label at 2 Hz or faster.
const STATE_GAP_NS: i64 = 1_100_000_000;

/// What was understood of a log.
#[derive(Clone, Debug, Serialize)]
pub struct LogReport {
    pub dataset: String,
    pub duration_s: f64,
    /// Path length of the ego vehicle.
    pub travel_m: f64,
    pub ego_poses: usize,
    pub cameras: Vec<CameraReport>,
    pub lidars: Vec<LidarReport>,
    /// Depth besides LiDAR.
    pub depths: Vec<DepthReport>,
    pub tracks: Vec<TrackReport>,
    /// What the reader ignored or assumed.
    pub notes: Vec<String>,
    /// What training would have to do without.
    pub missing: Vec<String>,
}

/// One camera.
#[derive(Clone, Debug, Serialize)]
pub struct CameraReport {
    pub camera: String,
    pub width: u32,
    pub height: u32,
    pub focal_px: [f64; 2],
    /// "none", "Brown-Conrady" or "Kannala-Brandt".
    pub distortion: &'static str,
    /// Time from the first to the last line of an image.
    pub readout_ms: f64,
    /// Height of the camera above the ego frame's origin.
    pub height_m: f64,
    /// Direction of view about the ego's z axis; 0 is ahead, left is positive.
    pub azimuth_deg: f64,
    pub images: usize,
    pub rate_hz: f64,
}

/// One scanner.
#[derive(Clone, Debug, Serialize)]
pub struct LidarReport {
    pub lidar: String,
    pub sweeps: usize,
    pub rate_hz: f64,
    /// Mean over the sweeps.
    pub points: u64,
}

/// One track.
#[derive(Clone, Debug, Serialize)]
pub struct TrackReport {
    pub track: String,
    pub class: String,
    /// Length, width, height.
    pub size_m: [f64; 3],
    pub states: usize,
    /// Images in which the cuboid's centre lies.
    pub images: usize,
    /// Distance of the cuboid's centre from the camera over those images.
    pub nearest_m: Option<f64>,
    pub farthest_m: Option<f64>,
    /// Distance between its outermost positions in the world.
    pub moved_m: f64,
    pub moves: bool,
}

impl LogReport {
    pub fn new(log: &v1::DriveLog) -> Self {
        let times: Vec<i64> = log.frames.iter().map(|f| f.timestamp_ns).collect();
        let steps = log.world_from_ego.windows(2);
        let position = |p: &v1::TimedPose| rigid_from_wire(p.pose.as_ref()).translation_m;
        let mut report = Self {
            dataset: log.dataset.clone(),
            duration_s: span_s(&times),
            travel_m: steps
                .map(|pair| position(&pair[0]).distance(position(&pair[1])))
                .sum(),
            ego_poses: log.world_from_ego.len(),
            cameras: log
                .cameras
                .iter()
                .map(|camera| camera_report(log, camera))
                .collect(),
            lidars: lidar_reports(log),
            depths: depth_reports(log),
            tracks: log
                .tracks
                .iter()
                .map(|track| track_report(log, track))
                .collect(),
            notes: log.notes.clone(),
            missing: Vec::new(),
        };
        report.missing = missing(log, &report);
        report
    }
}

fn span_s(times_ns: &[i64]) -> f64 {
    let span = times_ns.iter().max().zip(times_ns.iter().min());
    span.map_or(0.0, |(last, first)| (last - first) as f64 * 1e-9)
}

fn rate_hz(times_ns: &[i64]) -> f64 {
    let span = span_s(times_ns);
    if span > 0.0 {
        (times_ns.len() - 1) as f64 / span
    } else {
        0.0
    }
}

fn camera_report(log: &v1::DriveLog, camera: &v1::Camera) -> CameraReport {
    let own = log
        .frames
        .iter()
        .filter(|f| f.camera_id == camera.camera_id);
    let times: Vec<i64> = own.clone().map(|f| f.timestamp_ns).collect();
    let ego_from_camera = rigid_from_wire(camera.ego_from_camera.as_ref());
    let ahead = ego_from_camera.direction(glam::DVec3::Z);
    CameraReport {
        camera: camera.camera_id.clone(),
        width: camera.width,
        height: camera.height,
        focal_px: [camera.focal_x_px, camera.focal_y_px],
        distortion: match camera.distortion.as_ref().map(v1::Distortion::model) {
            None | Some(v1::DistortionModel::Unspecified) => "none",
            Some(v1::DistortionModel::BrownConrady) => "Brown-Conrady",
            Some(v1::DistortionModel::KannalaBrandt) => "Kannala-Brandt",
        },
        readout_ms: own.map(|f| f.readout_ns).max().unwrap_or(0) as f64 * 1e-6,
        height_m: ego_from_camera.translation_m.z,
        azimuth_deg: ahead.y.atan2(ahead.x).to_degrees(),
        images: times.len(),
        rate_hz: rate_hz(&times),
    }
}

fn lidar_reports(log: &v1::DriveLog) -> Vec<LidarReport> {
    let mut by_id: BTreeMap<&str, Vec<&v1::LidarSweep>> = BTreeMap::new();
    for sweep in &log.sweeps {
        by_id.entry(&sweep.lidar_id).or_default().push(sweep);
    }
    let reports = by_id.into_iter().map(|(lidar, sweeps)| {
        let times: Vec<i64> = sweeps.iter().map(|s| s.timestamp_ns).collect();
        let points = sweeps.iter().map(|s| {
            let bytes = s.points.as_ref().map_or(0, |blob| blob.size_bytes);
            bytes
                / if s.format() == v1::PointFormat::XyzitF32 {
                    20
                } else {
                    16
                }
        });
        LidarReport {
            lidar: lidar.to_owned(),
            sweeps: sweeps.len(),
            rate_hz: rate_hz(&times),
            points: points.sum::<u64>() / sweeps.len() as u64,
        }
    });
    reports.collect()
}

fn track_report(log: &v1::DriveLog, track: &v1::Track) -> TrackReport {
    let distances_m: Vec<f64> = log
        .frames
        .iter()
        .filter_map(|f| distance_in(log, f, track))
        .collect();
    let positions: Vec<_> = track
        .states
        .iter()
        .map(|state| rigid_from_wire(state.world_from_cuboid.as_ref()).translation_m)
        .collect();
    let low = positions
        .iter()
        .copied()
        .reduce(glam::DVec3::min)
        .unwrap_or_default();
    let high = positions
        .iter()
        .copied()
        .reduce(glam::DVec3::max)
        .unwrap_or_default();
    let moved_m = low.distance(high);
    TrackReport {
        track: track.track_id.clone(),
        class: track.source_class.clone(),
        size_m: vector_from_wire(track.size_m.as_ref()).to_array(),
        states: track.states.len(),
        images: distances_m.len(),
        nearest_m: distances_m.iter().copied().reduce(f64::min),
        farthest_m: distances_m.iter().copied().reduce(f64::max),
        moved_m,
        moves: moved_m > MOVING_M,
    }
}

/// Distance from the camera if the cuboid's centre is in the image.
fn distance_in(log: &v1::DriveLog, frame: &v1::CameraFrame, track: &v1::Track) -> Option<f64> {
    let wire = log
        .cameras
        .iter()
        .find(|c| c.camera_id == frame.camera_id)?;
    let camera = camera_from_wire(wire)?;
    let camera_from_world = camera_from_world(log, wire, frame.timestamp_ns)?;
    let pose = track_pose_at(track, frame.timestamp_ns)?;
    let centre = camera_from_world.point(pose.translation_m);
    let pixel = camera.project(centre)?;
    let size = DVec2::new(camera.width.into(), camera.height.into());
    let inside = pixel.cmpge(DVec2::ZERO).all() && pixel.cmplt(size).all();
    inside.then(|| centre.length())
}

/// `None` outside the trajectory.
pub(super) fn camera_from_world(
    log: &v1::DriveLog,
    camera: &v1::Camera,
    timestamp_ns: i64,
) -> Option<Rigid> {
    let world_from_ego = ego_pose_at(&log.world_from_ego, timestamp_ns)?;
    Some((world_from_ego * rigid_from_wire(camera.ego_from_camera.as_ref())).inverse())
}

fn missing(log: &v1::DriveLog, report: &LogReport) -> Vec<String> {
    let mut missing = Vec::new();
    let depth = match (&log.sweeps[..], &report.depths[..]) {
        ([], []) => Some("no LiDAR, depth map or SfM point: fields are trained without depth"),
        ([], _) => Some("no LiDAR: depth is that of the maps or points, and so are its errors"),
        _ => None,
    };
    missing.extend(depth.map(str::to_owned));
    let bare = log.frames.iter().filter(|f| f.depth_map.is_none()).count();
    if (1..log.frames.len()).contains(&bare) {
        missing.push(format!("{bare} images have no depth map"));
    }
    let far = |f: &&v1::CameraFrame| {
        let mut sweeps = log.sweeps.iter();
        !sweeps.any(|s| s.timestamp_ns.abs_diff(f.timestamp_ns) <= SWEEP_REACH_NS)
    };
    let alone = log.frames.iter().filter(far).count();
    if alone > 0 && !log.sweeps.is_empty() {
        missing.push(format!("{alone} images have no sweep within 0.1 s"));
    }
    if log.tracks.is_empty() {
        missing.push("no tracks: movers are not told from the background".to_owned());
    }
    let unseen = report.tracks.iter().filter(|t| t.images == 0).count();
    if unseen > 0 {
        missing.push(format!("{unseen} tracks are in no image"));
    }
    let has_gap = |t: &&v1::Track| {
        let mut pairs = t.states.windows(2);
        pairs.any(|pair| pair[1].timestamp_ns - pair[0].timestamp_ns > STATE_GAP_NS)
    };
    let gaps = log.tracks.iter().filter(has_gap).count();
    if gaps > 0 {
        missing.push(format!(
            "{gaps} tracks have gaps of more than a second, where they are interpolated"
        ));
    }
    let has_masks =
        |f: &v1::CameraFrame| f.instance_mask.is_some() || f.free_instance_mask.is_some();
    if !log.frames.iter().any(has_masks) {
        missing.push("no instance masks: a segmenter or LiDAR hulls stand in for them".to_owned());
    }
    missing
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::generator::{StreetConfig, StreetWorld};

    fn log() -> v1::DriveLog {
        let config = StreetConfig {
            frames: 3,
            width: 64,
            height: 48,
            travel_m: 4.0,
            supersample: 1,
            ..StreetConfig::default()
        };
        StreetWorld::new(&config)
            .unwrap()
            .read_log()
            .unwrap()
            .drive_log
    }

    #[test]
    fn a_street_is_described() {
        let report = LogReport::new(&log());
        assert_eq!(
            (report.cameras[0].images, report.cameras[0].distortion),
            (3, "none")
        );
        assert!(
            report.cameras[0].azimuth_deg.abs() < 1e-6,
            "{:?}",
            report.cameras[0]
        );
        assert!(
            (report.cameras[0].rate_hz - 6.0).abs() < 1e-6,
            "{:?}",
            report.cameras[0]
        );
        assert!(report.lidars[0].points > 100, "{:?}", report.lidars);
        let lead = report
            .tracks
            .iter()
            .find(|t| t.track == "moving-00")
            .unwrap();
        assert!(lead.moves && lead.images == 3, "{lead:?}");
        assert!((8.0..20.0).contains(&lead.nearest_m.unwrap()), "{lead:?}");
        assert!(
            !report
                .tracks
                .iter()
                .any(|t| t.track.starts_with("parked") && t.moves)
        );
    }

    #[test]
    fn missing_pieces_are_named() {
        let whole = LogReport::new(&log()).missing;
        let mut log = log();
        log.sweeps.truncate(1);
        log.tracks.clear();
        let bare = LogReport::new(&log).missing;
        for text in ["no tracks", "2 images have no sweep"] {
            assert!(bare.iter().any(|line| line.contains(text)), "{bare:?}");
            assert!(!whole.iter().any(|line| line.contains(text)), "{whole:?}");
        }
    }
}
