//! Sweeps that belong to no camera frame: scanners turn ten or twenty times a second, the frames of most data sets are fewer.

use std::collections::{HashMap, HashSet};

use glam::DVec3;

use crate::domain::drive_log::DriveLog;

/// Nearer to another sweep of the same scanner, one shows hardly more: a standing one sees the same again.
const SPACING_M: f64 = 0.5;

/// Indices of the sweeps to be read besides those `taken`, in time order: of every scanner, those taken [`SPACING_M`] from any other.
pub(super) fn sweeps_between(log: &DriveLog, taken: &HashSet<usize>) -> Vec<usize> {
    let place = |index: usize| {
        let pose = log.world_from_ego.at(log.sweeps[index].timestamp_ns)?;
        Some(pose.translation_m)
    };
    let mut places: HashMap<&str, Vec<DVec3>> = HashMap::new();
    for (index, sweep) in log.sweeps.iter().enumerate() {
        if taken.contains(&index) {
            let places = places.entry(&sweep.lidar_id).or_default();
            places.extend(place(index));
        }
    }
    let mut order: Vec<usize> = (0..log.sweeps.len())
        .filter(|index| !taken.contains(index))
        .collect();
    order.sort_by_key(|index| (log.sweeps[*index].timestamp_ns, *index));
    order.retain(|index| {
        let Some(at) = place(*index) else {
            return false;
        };
        let places = places.entry(&log.sweeps[*index].lidar_id).or_default();
        let is_apart = places.iter().all(|p| p.distance(at) >= SPACING_M);
        if is_apart {
            places.push(at);
        }
        is_apart
    });
    order
}
