//! Ego motion through time.

use std::collections::BTreeMap;

use backlot_engine::camera::Rigid;
use backlot_proto::v1;

use crate::geometry::rigid_to_wire;

/// `world_from_ego` poses, strictly increasing in time.
#[derive(Clone, Debug)]
pub(crate) struct Trajectory {
    poses: Vec<(i64, Rigid)>,
}

impl Trajectory {
    /// Requires at least one pose.
    pub(crate) fn new(poses: BTreeMap<i64, Rigid>) -> Self {
        assert!(!poses.is_empty(), "a trajectory has at least one pose");
        Self {
            poses: poses.into_iter().collect(),
        }
    }

    pub(crate) fn poses(&self) -> &[(i64, Rigid)] {
        &self.poses
    }

    /// The pose at a time: linear in translation, slerp in rotation, and extrapolated from the outermost two poses.
    pub(crate) fn at(&self, timestamp_ns: i64) -> Rigid {
        if let [(_, pose)] = self.poses[..] {
            return pose;
        }
        let after = self.poses.partition_point(|(t, _)| *t < timestamp_ns);
        let after = after.clamp(1, self.poses.len() - 1);
        let (t0, pose0) = self.poses[after - 1];
        let (t1, pose1) = self.poses[after];
        pose0.interpolate(&pose1, (timestamp_ns - t0) as f64 / (t1 - t0) as f64)
    }

    /// Adds extrapolated ends so that the trajectory spans `[first_ns, last_ns]`; says whether it had to.
    pub(crate) fn cover(&mut self, first_ns: i64, last_ns: i64) -> bool {
        let mut extended = false;
        if first_ns < self.poses[0].0 {
            self.poses.insert(0, (first_ns, self.at(first_ns)));
            extended = true;
        }
        if last_ns > self.poses[self.poses.len() - 1].0 {
            self.poses.push((last_ns, self.at(last_ns)));
            extended = true;
        }
        extended
    }

    /// Puts the trajectory into the manifest, extended to every image and sweep; they may lie just outside the poses.
    pub(crate) fn record(mut self, log: &mut v1::DriveLog) {
        let images = log.frames.iter().map(|frame| frame.timestamp_ns);
        let sweeps = log.sweeps.iter().map(|sweep| sweep.timestamp_ns);
        let times: Vec<i64> = images.chain(sweeps).collect();
        let span = times.iter().min().zip(times.iter().max());
        if span.is_some_and(|(&first, &last)| self.cover(first, last)) {
            let note = "ego poses extrapolated to the first or last image or sweep";
            log.notes.push(note.to_owned());
        }
        let timed = self.poses.iter().map(|(time, pose)| v1::TimedPose {
            timestamp_ns: *time,
            pose: Some(rigid_to_wire(pose)),
        });
        log.world_from_ego = timed.collect();
    }

    /// An anchor at the first pose, level and along its heading: the fields of a log are f32 and want small numbers.
    pub(crate) fn local_from_world(&self) -> Rigid {
        let (_, first) = self.poses[0];
        Rigid::from_heading(first.heading_rad(), first.translation_m).inverse()
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;

    fn straight() -> Trajectory {
        let pose = |x| Rigid::from_heading(0.0, DVec3::new(x, 0.0, 0.0));
        Trajectory::new(BTreeMap::from([
            (0, pose(0.0)),
            (10, pose(1.0)),
            (30, pose(2.0)),
        ]))
    }

    #[test]
    fn poses_are_interpolated_and_extrapolated() {
        for (t, x) in [
            (0, 0.0),
            (5, 0.5),
            (10, 1.0),
            (20, 1.5),
            (30, 2.0),
            (-10, -1.0),
            (50, 3.0),
        ] {
            assert!((straight().at(t).translation_m.x - x).abs() < 1e-12, "{t}");
        }
    }

    #[test]
    fn covering_adds_only_what_is_missing() {
        let mut trajectory = straight();
        assert!(!trajectory.cover(0, 30));
        assert!(trajectory.cover(-10, 30));
        assert_eq!(trajectory.poses().len(), 4);
        assert!((trajectory.poses()[0].1.translation_m.x + 1.0).abs() < 1e-12);
    }
}
