//! The ego trajectory, from either source of poses.

use std::collections::BTreeMap;
use std::path::Path;

use backlot_engine::camera::Rigid;
use glam::DVec3;

use super::calibration::Calibration;
use super::clock::Clock;
use super::{drive, poses};
use crate::read_log::trajectory::Trajectory;
use crate::read_log::{Error, Result};

/// Ego poses at the image times, from poses of camera 0 given by frame.
pub(super) fn from_odometry(
    path: &Path,
    calibration: &Calibration,
    frames: &BTreeMap<u32, i64>,
    notes: &mut Vec<String>,
) -> Result<(Trajectory, Rigid)> {
    let poses = poses::read_odometry(path)?;
    let unused = poses.keys().filter(|f| !frames.contains_key(f)).count();
    if unused > 0 {
        notes.push(format!("{unused} poses of frames without an image ignored"));
    }
    let camera0_from_velodyne = calibration.camera0_from_velodyne;
    let mut world_from_ego = BTreeMap::new();
    let mut world_from_given = None;
    for (frame, &time) in frames {
        let what = || format!("no pose for frame {frame}, which has an image");
        let pose = *poses
            .get(frame)
            .ok_or_else(|| Error::malformed(path, what()))?;
        let given_from_ego = pose * camera0_from_velodyne;
        let world_from_given = *world_from_given.get_or_insert_with(|| given_from_ego.inverse());
        insert_pose(
            &mut world_from_ego,
            *frame,
            time,
            world_from_given * given_from_ego,
            path,
        )?;
    }
    Ok((Trajectory::new(world_from_ego), Rigid::IDENTITY))
}

/// Ego poses at the oxts times; the local frame is the world turned to the first heading.
pub(super) fn from_oxts(
    drive: &Path,
    calibration: &Calibration,
    frames: &BTreeMap<u32, i64>,
    notes: &mut Vec<String>,
) -> Result<(Trajectory, Rigid)> {
    let folder = drive.join("oxts/data");
    let mut files = drive::frame_files(&folder, &["txt"])?;
    if files.is_empty() {
        return Err(Error::Missing {
            path: folder.join("*.txt"),
            hint: "without oxts give the ego poses with --poses FILE".to_owned(),
        });
    }
    let clock = Clock::read(&drive.join("oxts"))?;
    let all = files.len();
    files.retain(|frame, _| frames.contains_key(frame));
    if files.len() < all {
        let unused = all - files.len();
        notes.push(format!(
            "{unused} oxts packets of frames without an image ignored"
        ));
    }
    let poses = poses::read_oxts(&files)?;
    from_packets(&poses, &clock, calibration, frames, &folder)
}

/// Ego poses at the packets' times, from poses of the IMU given by frame; `source` is where they are from.
pub(super) fn from_packets(
    poses: &BTreeMap<u32, Rigid>,
    clock: &Clock,
    calibration: &Calibration,
    frames: &BTreeMap<u32, i64>,
    source: &Path,
) -> Result<(Trajectory, Rigid)> {
    let velodyne_from_imu = calibration.velodyne_from_imu()?;
    let mut world_from_ego = BTreeMap::new();
    let mut origin_m = None;
    for (frame, &image_time) in frames {
        let what = || format!("no packet for frame {frame}, which has an image");
        let pose = *poses
            .get(frame)
            .ok_or_else(|| Error::malformed(source, what()))?;
        let mut pose = pose * velodyne_from_imu.inverse();
        pose.translation_m -= *origin_m.get_or_insert(pose.translation_m);
        let time = match clock {
            Clock::Assumed => image_time,
            Clock::Read(_) => clock.at(*frame).unwrap_or(image_time),
        };
        insert_pose(&mut world_from_ego, *frame, time, pose, source)?;
    }
    let trajectory = Trajectory::new(world_from_ego);
    let first_heading = trajectory.poses()[0].1.heading_rad();
    let local_from_world = Rigid::from_heading(-first_heading, DVec3::ZERO);
    Ok((trajectory, local_from_world))
}

fn insert_pose(
    poses: &mut BTreeMap<i64, Rigid>,
    frame: u32,
    time: i64,
    pose: Rigid,
    path: &Path,
) -> Result<()> {
    let later = poses.last_key_value().is_none_or(|(last, _)| time > *last);
    if !later {
        let what = format!("frame {frame} is not later than the frame before it");
        return Err(Error::malformed(path, what));
    }
    poses.insert(time, pose);
    Ok(())
}
