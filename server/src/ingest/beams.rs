//! LiDAR pulses that show which space is free.

use std::collections::HashSet;

use backlot_engine::train::LidarBeam;
use backlot_engine::view::Split;

use super::frame::SWEEP_TOLERANCE_NS;
use super::lidar::{WorldReturn, nearest_sweeps};
use crate::domain::drive_log::DriveLog;

/// Pulses of one background: 56 MB. Of more, every sweep gives an equal share.
const MOST_BEAMS: usize = 2_000_000;
/// Nearer returns are on the ego vehicle or within the sensor's blind zone.
pub(super) const NEAREST_M: f64 = 3.0;

/// Gathers the pulses of sweeps, each sweep once.
#[derive(Debug)]
pub(crate) struct Beams {
    /// Taken already, or beside a held-out frame, whose depths must stay unseen.
    done: HashSet<usize>,
    most_per_sweep: usize,
}

impl Beams {
    /// `splits` has the split of every frame of the log.
    pub(crate) fn new(log: &DriveLog, splits: &[Option<Split>]) -> Self {
        let frames = log.frames.iter().zip(splits);
        let held_out = frames.filter(|(_, split)| **split == Some(Split::HeldOut));
        Self {
            done: held_out
                .flat_map(|(f, _)| nearest_sweeps(log, f.timestamp_ns, SWEEP_TOLERANCE_NS))
                .collect(),
            most_per_sweep: MOST_BEAMS / log.sweeps.len().max(1),
        }
    }

    /// Whether a sweep may be read and was not before.
    pub(super) fn take(&mut self, sweep: usize) -> bool {
        self.done.insert(sweep)
    }

    /// Sweeps that were taken or must not be.
    pub(super) fn done(&self) -> &HashSet<usize> {
        &self.done
    }

    /// Adds a sweep's pulses in the local frame.
    pub(super) fn add(
        &self,
        log: &DriveLog,
        returns: &[WorldReturn],
        view: u32,
        out: &mut Vec<LidarBeam>,
    ) {
        let every = returns.len().div_ceil(self.most_per_sweep.max(1)).max(1);
        let spread = returns.iter().step_by(every);
        let far = spread.filter(|r| r.world_m.distance(r.origin_m) >= NEAREST_M);
        let local = |p| log.local_from_world.point(p).as_vec3().to_array();
        out.extend(far.map(|r| LidarBeam {
            origin_m: local(r.origin_m),
            return_m: local(r.world_m),
            view,
        }));
    }
}
