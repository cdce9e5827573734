//! Poses over time.

use backlot_engine::camera::Rigid;
use serde::{Deserialize, Serialize};

/// A pose at one instant.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct TimedPose {
    pub timestamp_ns: i64,
    pub pose: Rigid,
}

/// Poses strictly increasing in time; between two of them translation is interpolated linearly and rotation by slerp.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Trajectory {
    poses: Vec<TimedPose>,
}

impl Trajectory {
    /// The order of `poses` is checked by `ingest`, which names the offending one.
    pub fn new(poses: Vec<TimedPose>) -> Self {
        Self { poses }
    }

    pub fn poses(&self) -> &[TimedPose] {
        &self.poses
    }

    /// The pose at `timestamp_ns`; `None` outside the recorded time.
    pub fn at(&self, timestamp_ns: i64) -> Option<Rigid> {
        interpolate(&self.poses, timestamp_ns, |p| (p.timestamp_ns, p.pose))
    }

    /// First and last instant, both included.
    pub fn span_ns(&self) -> Option<(i64, i64)> {
        Some((
            self.poses.first()?.timestamp_ns,
            self.poses.last()?.timestamp_ns,
        ))
    }

    /// Path length in metres.
    pub fn travel_m(&self) -> f64 {
        self.poses
            .windows(2)
            .map(|w| w[1].pose.translation_m.distance(w[0].pose.translation_m))
            .sum()
    }
}

/// Interpolates among entries sorted by time; `key` gives an entry's time and pose. `None` outside the covered time.
pub(super) fn interpolate<T>(
    entries: &[T],
    timestamp_ns: i64,
    key: impl Fn(&T) -> (i64, Rigid),
) -> Option<Rigid> {
    let after = entries.partition_point(|e| key(e).0 < timestamp_ns);
    let (end_ns, end) = key(entries.get(after)?);
    if end_ns == timestamp_ns {
        return Some(end);
    }
    let (start_ns, start) = key(entries.get(after.checked_sub(1)?)?);
    // Differences first: an i64 of nanoseconds since 1970 does not fit an f64.
    let fraction = timestamp_ns.abs_diff(start_ns) as f64 / end_ns.abs_diff(start_ns) as f64;
    Some(start.interpolate(&end, fraction))
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DQuat, DVec3};

    fn trajectory() -> Trajectory {
        let pose = |t, heading, x| TimedPose {
            timestamp_ns: t,
            pose: Rigid::from_heading(heading, DVec3::new(x, 0.0, 0.0)),
        };
        let start = 1_600_000_000_000_000_000;
        Trajectory::new(vec![
            pose(start, 0.0, 0.0),
            pose(start + 100, 1.0, 2.0),
            pose(start + 200, 1.0, 2.0),
        ])
    }

    #[test]
    fn interpolates_between_poses_at_epoch_nanoseconds() {
        let start = 1_600_000_000_000_000_000;
        let got = trajectory().at(start + 25).expect("covered");
        assert!((got.translation_m.x - 0.5).abs() < 1e-12);
        assert!(got.rotation.dot(DQuat::from_rotation_z(0.25)) > 1.0 - 1e-12);
    }

    #[test]
    fn answers_nothing_outside_the_recorded_time() {
        let start = 1_600_000_000_000_000_000;
        let t = trajectory();
        assert!(t.at(start - 1).is_none());
        assert!(t.at(start + 201).is_none());
        assert!(t.at(start).is_some() && t.at(start + 200).is_some());
        assert!(Trajectory::default().at(0).is_none());
    }

    #[test]
    fn travel_is_the_path_length() {
        assert!((trajectory().travel_m() - 2.0).abs() < 1e-12);
    }
}
