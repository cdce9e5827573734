//! Poses at any time, interpolated as the wire contract says: linear in translation, slerp in rotation.

use backlot_engine::camera::Rigid;
use backlot_proto::v1;

use crate::geometry::rigid_from_wire;

/// The `world_from_ego` pose at a time; `None` outside the trajectory.
pub fn ego_pose_at(poses: &[v1::TimedPose], timestamp_ns: i64) -> Option<Rigid> {
    interpolate(poses, timestamp_ns, |timed| {
        (timed.timestamp_ns, timed.pose.as_ref())
    })
}

/// The `world_from_cuboid` pose of a track at a time; `None` where the track has no state around it.
pub fn track_pose_at(track: &v1::Track, timestamp_ns: i64) -> Option<Rigid> {
    interpolate(&track.states, timestamp_ns, |state| {
        (state.timestamp_ns, state.world_from_cuboid.as_ref())
    })
}

fn interpolate<T>(
    states: &[T],
    timestamp_ns: i64,
    read: impl Fn(&T) -> (i64, Option<&v1::RigidTransform>),
) -> Option<Rigid> {
    let after = states.partition_point(|state| read(state).0 < timestamp_ns);
    let (t1, pose1) = read(states.get(after)?);
    let pose1 = rigid_from_wire(pose1);
    if t1 == timestamp_ns {
        return Some(pose1);
    }
    let (t0, pose0) = read(states.get(after.checked_sub(1)?)?);
    let fraction = (timestamp_ns - t0) as f64 / (t1 - t0) as f64;
    Some(rigid_from_wire(pose0).interpolate(&pose1, fraction))
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::geometry::rigid_to_wire;

    #[test]
    fn nothing_is_known_outside_the_states() {
        let state = |timestamp_ns, x| v1::TimedPose {
            timestamp_ns,
            pose: Some(rigid_to_wire(&Rigid::from_heading(
                0.0,
                DVec3::new(x, 0.0, 0.0),
            ))),
        };
        let poses = [state(10, 1.0), state(20, 2.0)];
        let x = |t| ego_pose_at(&poses, t).map(|pose| pose.translation_m.x);
        assert_eq!((x(9), x(21)), (None, None));
        assert_eq!((x(10), x(20)), (Some(1.0), Some(2.0)));
        assert!((x(15).unwrap() - 1.5).abs() < 1e-12);
    }
}
