//! Simulated LiDAR returns per object: pipelines drop boxes without points, so every label carries a count.

use std::f64::consts::PI;

use glam::{DVec2, DVec3};

use super::composition::Composition;
use super::frame::RenderedFrame;
use super::valid_region::ValidRegion;

/// Velodyne HDL-64E: 64 beams from +2 to -24.8 degrees, 0.2 degrees apart in azimuth at 10 Hz.
const BEAMS: usize = 64;
const TOP_RAD: f64 = 2.0 * PI / 180.0;
const BOTTOM_RAD: f64 = -24.8 * PI / 180.0;
const AZIMUTHS: usize = 1800;
/// Height of KITTI's scanner; an ego frame on the ground carries its scanner this far above.
const MOUNT_HEIGHT_M: f64 = 1.73;
const MAX_RANGE_M: f64 = 100.0;

/// Returns by instance id, for ids below `slots`: beams whose direction, seen from the scanner, meets a pixel of the instance.
pub(super) fn count_returns(
    composition: &Composition,
    region: &ValidRegion,
    frame: &RenderedFrame,
    slots: usize,
) -> Vec<u32> {
    let scanner = scanner_position(composition, region);
    let ego_from_local = composition.local_from_ego.inverse();
    // Per beam: squared angle of the pixel nearest to it, in cells, and that pixel's instance.
    let mut nearest = vec![(f64::INFINITY, 0u16); BEAMS * AZIMUTHS];
    for (i, instance) in frame.instance.iter().enumerate() {
        let z = f64::from(frame.depth_z_m[i]);
        if z <= 0.0 {
            continue;
        }
        let column = (i % frame.width as usize) as f64 + 0.5;
        let row = (i / frame.width as usize) as f64 + 0.5;
        let direction = composition.camera.direction(DVec2::new(column, row));
        let p = composition
            .local_from_camera
            .point(direction * (z / direction.z));
        let d = ego_from_local.direction(p - scanner);
        if let Some((cell, squared)) = beam_of(d)
            && squared < nearest[cell].0
        {
            nearest[cell] = (squared, *instance);
        }
    }
    let mut counts = vec![0; slots];
    for (_, instance) in nearest.iter().filter(|(squared, _)| squared.is_finite()) {
        counts[usize::from(*instance)] += 1;
    }
    counts
}

fn scanner_position(composition: &Composition, region: &ValidRegion) -> DVec3 {
    let ego = composition.local_from_ego;
    let above_ground = region
        .ground_height(ego.translation_m.truncate())
        .map_or(MOUNT_HEIGHT_M, |ground| ego.translation_m.z - ground);
    ego.point(DVec3::Z * (MOUNT_HEIGHT_M - above_ground).max(0.0))
}

/// The beam whose cell holds a direction, and the squared distance from its centre in cells.
fn beam_of(d: DVec3) -> Option<(usize, f64)> {
    if d.length_squared() > MAX_RANGE_M * MAX_RANGE_M {
        return None;
    }
    let elevation = libm::atan2(d.z, d.truncate().length());
    let beam = (TOP_RAD - elevation) / (TOP_RAD - BOTTOM_RAD) * (BEAMS - 1) as f64;
    let turn = (libm::atan2(d.y, d.x) + PI) / (2.0 * PI) * AZIMUTHS as f64;
    let (row, column) = (libm::round(beam), libm::floor(turn));
    if !(0.0..BEAMS as f64).contains(&row) {
        return None;
    }
    let (off_beam, off_turn) = (beam - row, turn - column - 0.5);
    let cell = row as usize * AZIMUTHS + (column as usize).min(AZIMUTHS - 1);
    Some((cell, off_beam * off_beam + off_turn * off_turn))
}
