//! LiDAR returns placed in the world at their own times, each with the cuboid it lies in.

use backlot_engine::camera::Rigid;
use glam::DVec3;

use super::movers::is_moving;
use super::points::{SweepPoint, decode_points};
use crate::domain::drive_log::{DriveLog, LidarSweep, Track};

/// Cuboids are grown by this on every side before points are assigned: annotations clip mirrors and bumpers.
pub(super) const OWNER_MARGIN_M: f64 = 0.1;
/// How far an object may move while one sweep is taken.
const SWEEP_MOTION_M: f64 = 4.0;

/// One return in the world frame at its own time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct WorldReturn {
    pub world_m: DVec3,
    /// Where the sensor was then.
    pub origin_m: DVec3,
    /// The track whose cuboid holds it.
    pub owner: Option<Owner>,
}

/// A return on a tracked object.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Owner {
    /// Index into the log's tracks.
    pub track: usize,
    /// Position in the cuboid's frame at the return's time.
    pub cuboid_m: DVec3,
}

/// Places the points of a sweep; points at times the ego trajectory does not cover are dropped.
pub(crate) fn place_sweep(log: &DriveLog, sweep: &LidarSweep, bytes: &[u8]) -> Vec<WorldReturn> {
    let tracks = NearbyTracks::at(log, sweep.timestamp_ns);
    let mut ego = EgoAt::new(log, sweep);
    decode_points(bytes, sweep.format)
        .filter_map(|point| {
            let timestamp_ns = sweep.timestamp_ns.checked_add(point.delay_ns)?;
            let (world_m, origin_m) = ego.place(&point, timestamp_ns)?;
            let owner = tracks.owner_of(world_m, timestamp_ns);
            Some(WorldReturn {
                world_m,
                origin_m,
                owner,
            })
        })
        .collect()
}

/// The tracks around a moment, to be asked for points of about that time.
pub(super) struct NearbyTracks<'a>(Vec<Nearby<'a>>);

impl<'a> NearbyTracks<'a> {
    pub(super) fn at(log: &'a DriveLog, timestamp_ns: i64) -> Self {
        Self::of(log, timestamp_ns, |_| true)
    }

    /// Those that never move.
    pub(super) fn standing_at(log: &'a DriveLog, timestamp_ns: i64) -> Self {
        Self::of(log, timestamp_ns, |track| !is_moving(track))
    }

    fn of(log: &'a DriveLog, timestamp_ns: i64, wanted: impl Fn(&Track) -> bool) -> Self {
        let tracks = log.tracks.iter().enumerate();
        let nearby = tracks
            .filter(|(_, track)| wanted(track))
            .filter_map(|(index, track)| {
                let state = track.nearest_state(timestamp_ns)?;
                let reach_m = track.size_m.length() / 2.0 + OWNER_MARGIN_M + SWEEP_MOTION_M;
                Some(Nearby {
                    index,
                    track,
                    centre_m: state.world_from_cuboid.translation_m,
                    reach_m,
                })
            });
        Self(nearby.collect())
    }

    /// The track whose cuboid holds the position at a time.
    pub(super) fn owner_of(&self, world_m: DVec3, timestamp_ns: i64) -> Option<Owner> {
        self.0
            .iter()
            .filter(|n| world_m.distance_squared(n.centre_m) < n.reach_m * n.reach_m)
            .find_map(|n| owner_in(n, world_m, timestamp_ns))
    }
}

struct Nearby<'a> {
    index: usize,
    track: &'a Track,
    centre_m: DVec3,
    reach_m: f64,
}

fn owner_in(nearby: &Nearby<'_>, world_m: DVec3, timestamp_ns: i64) -> Option<Owner> {
    let pose = nearby.track.at(timestamp_ns)?;
    let cuboid_m = pose.inverse().point(world_m);
    let limit = nearby.track.size_m / 2.0 + OWNER_MARGIN_M;
    cuboid_m.abs().cmple(limit).all().then_some(Owner {
        track: nearby.index,
        cuboid_m,
    })
}

/// World from LiDAR at a point's time; points of one time share the interpolation.
struct EgoAt<'a> {
    log: &'a DriveLog,
    ego_from_lidar: Rigid,
    last: Option<(i64, Rigid)>,
}

impl<'a> EgoAt<'a> {
    fn new(log: &'a DriveLog, sweep: &LidarSweep) -> Self {
        Self {
            log,
            ego_from_lidar: sweep.ego_from_lidar,
            last: None,
        }
    }

    /// The point and the sensor in the world.
    fn place(&mut self, point: &SweepPoint, timestamp_ns: i64) -> Option<(DVec3, DVec3)> {
        let world_from_lidar = match self.last {
            Some((time, pose)) if time == timestamp_ns => pose,
            _ => {
                let pose = self.log.world_from_ego.at(timestamp_ns)? * self.ego_from_lidar;
                self.last = Some((timestamp_ns, pose));
                pose
            }
        };
        let world_m = world_from_lidar.point(point.position_m.as_dvec3());
        Some((world_m, world_from_lidar.translation_m))
    }
}

/// Of every LiDAR, the sweep nearest in time, if it is within `tolerance_ns`; indices into the log's sweeps.
pub(crate) fn nearest_sweeps(log: &DriveLog, timestamp_ns: i64, tolerance_ns: u64) -> Vec<usize> {
    let mut nearest: Vec<usize> = Vec::new();
    let distance = |i: usize| log.sweeps[i].timestamp_ns.abs_diff(timestamp_ns);
    for (i, sweep) in log.sweeps.iter().enumerate() {
        if distance(i) > tolerance_ns {
            continue;
        }
        let same = nearest
            .iter_mut()
            .find(|j| log.sweeps[**j].lidar_id == sweep.lidar_id);
        match same {
            Some(best) if distance(*best) <= distance(i) => {}
            Some(best) => *best = i,
            None => nearest.push(i),
        }
    }
    nearest
}
