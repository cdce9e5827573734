//! Ground that other road users drove over: no camera may have seen it beneath or behind them, yet it carried them.

use super::footprint::Footprint;
use super::ground::{Found, neighbours};
use super::path::DrivenPath;
use super::recording::{RecordedTrack, Recording};
use super::region_builder::RegionConfig;
use super::valid_region::ValidRegion;
use crate::camera::Rigid;
use crate::class::ObjectClass;
use glam::{DVec2, DVec3};

/// Cells of known ground under a mover's cuboids, from which on they say how far annotated bottoms lie off the ground.
const LEAST_KNOWN: usize = 8;
/// Cuboids farther off the ground than this do not stand on it.
const MOST_OFFSET_M: f64 = 0.3;

/// Cosine of the steepest pitch or roll on a road; of cuboids that lie on their sides the bottom is no ground.
const LEAST_UPRIGHT: f64 = 0.8;

/// Which cells were driven over. Where no ground was found, or what was found is a step, the ground is that of the cuboids' bottoms,
/// corrected by the ground that is known under the same mover; where that would be a step beside known ground, nothing is said.
pub(super) fn driven_cells(
    recording: &Recording,
    path: &DrivenPath,
    config: &RegionConfig,
    region: &mut ValidRegion,
    found: &mut [Found],
) -> Vec<bool> {
    let mut sums = vec![(0.0, 0u32); found.len()];
    for track in recording.tracks.iter().filter(|t| drives_on_roads(t)) {
        add_bottoms(track, region, found, &mut sums);
    }
    let is_wanted =
        |cell: usize| sums[cell].1 > 0 && path.is_beside(region.centre(cell), config.max_lateral_m);
    let mut driven: Vec<bool> = (0..found.len()).map(is_wanted).collect();
    for cell in 0..found.len() {
        if !driven[cell] || found[cell] == Found::Ground {
            continue;
        }
        let (sum, count) = sums[cell];
        let height_m = sum / f64::from(count);
        let is_step = |n: usize| {
            found[n] == Found::Ground && (region.ground_m[n] - height_m).abs() > config.max_step_m
        };
        if neighbours(region, cell, false).any(is_step) {
            driven[cell] = false;
        } else {
            region.ground_m[cell] = height_m;
        }
    }
    for (found, _) in found.iter_mut().zip(&driven).filter(|(_, driven)| **driven) {
        *found = Found::Ground;
    }
    driven
}

/// What leaves the road, or runs on rails, proves nothing for a car.
fn drives_on_roads(track: &RecordedTrack) -> bool {
    use ObjectClass::{Bus, Car, Truck, Van};
    track.moving && matches!(track.class, Car | Van | Truck | Bus)
}

/// Adds the ground heights under a mover to the cells' sums; none if it does not say how its cuboids stand on the ground.
fn add_bottoms(
    track: &RecordedTrack,
    region: &ValidRegion,
    found: &[Found],
    sums: &mut [(f64, u32)],
) {
    let mut bottoms: Vec<(usize, f64)> = Vec::new();
    let poses = track.local_from_cuboid.iter().flatten();
    for pose in poses.filter(|p| p.direction(DVec3::Z).z > LEAST_UPRIGHT) {
        let footprint = Footprint::of_cuboid(pose, track.size_m);
        let cells = region.cells_under(&footprint).unwrap_or_default();
        bottoms.extend(cells.into_iter().map(|cell| {
            let at = region.centre(cell);
            (cell, bottom_height(pose, track.size_m.z, at))
        }));
    }
    let known = bottoms
        .iter()
        .filter(|(cell, _)| found[*cell] == Found::Ground);
    let mut offsets: Vec<f64> = known.map(|(cell, z)| region.ground_m[*cell] - z).collect();
    offsets.sort_by(f64::total_cmp);
    if offsets.len() < LEAST_KNOWN || offsets[offsets.len() / 2].abs() > MOST_OFFSET_M {
        return;
    }
    let offset_m = offsets[offsets.len() / 2];
    for (cell, z) in bottoms {
        sums[cell].0 += z + offset_m;
        sums[cell].1 += 1;
    }
}

/// Height of the plane of a cuboid's bottom at a place.
fn bottom_height(local_from_cuboid: &Rigid, height_m: f64, at: DVec2) -> f64 {
    let bottom = local_from_cuboid.point(DVec3::NEG_Z * (0.5 * height_m));
    let normal = local_from_cuboid.direction(DVec3::Z);
    bottom.z - normal.truncate().dot(at - bottom.truncate()) / normal.z
}
