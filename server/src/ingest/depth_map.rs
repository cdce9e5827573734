//! Samples of a depth map as returns.

use backlot_engine::camera::{Camera, Rigid};
use backlot_engine::view::DepthSource;

use super::lidar::{NearbyTracks, Owner};
use super::projected::ProjectedReturn;
use crate::domain::drive_log::{DEPTH_UNKNOWN, DepthMap, DepthMapKind, DriveLog};

/// A disparity wrong by a third of a pixel is 5 % at 30 m behind a baseline of half a metre, where LiDAR is wrong by 0.1 %.
const STEREO_WEIGHT: f32 = 0.5;
/// Networks are wrong by 5 to 10 % of the range, and neighbouring pixels are wrong together, so that more of them help little.
const MONOCULAR_WEIGHT: f32 = 0.2;
/// Depth maps are measured against LiDAR up to here; beyond, their errors are larger than what stands there.
const REACH_M: f64 = 80.0;
/// Angle between samples in radians: as dense as a scanner's returns.
const SPACING_RAD: f64 = 0.004;
/// A pixel whose neighbour differs by more than this part lies on an edge, over which maps bleed. Ground seen at a grazing angle
/// stays below it.
const EDGE: f64 = 0.1;

/// The weight of a map's samples relative to LiDAR returns.
pub(super) fn weight_of(map: &DepthMap) -> f32 {
    map.weight.map_or(
        match map.kind {
            DepthMapKind::Stereo => STEREO_WEIGHT,
            DepthMapKind::Monocular => MONOCULAR_WEIGHT,
        },
        |weight| weight as f32,
    )
}

/// The map's samples in the world, with the cuboids of `timestamp_ns` that hold them. `units` is the decoded map, of the camera's size.
pub(super) fn map_returns(
    log: &DriveLog,
    timestamp_ns: i64,
    map: &DepthMap,
    units: &[u16],
    camera: &Camera,
    world_from_camera: &Rigid,
) -> Vec<ProjectedReturn> {
    let (width, height) = (camera.width as usize, camera.height as usize);
    let spacing = (camera.focal_px * SPACING_RAD).round().as_usizevec2();
    let spacing = spacing.max(glam::USizeVec2::ONE);
    let tracks = NearbyTracks::at(log, timestamp_ns);
    let weight = weight_of(map);
    let mut returns = Vec::new();
    for row in (spacing.y / 2..height).step_by(spacing.y) {
        for column in (spacing.x / 2..width).step_by(spacing.x) {
            let at = row * width + column;
            if units[at] == DEPTH_UNKNOWN || on_edge(units, width, height, column, row) {
                continue;
            }
            let pixel = camera.pixel_centre(at);
            let direction = camera.direction(pixel);
            // Camera z to distance along the ray.
            let range_m = f64::from(units[at]) * map.unit_m / direction.z;
            if !(range_m > 0.0 && range_m <= REACH_M) {
                continue;
            }
            let world_m = world_from_camera.point(direction * range_m);
            let owner: Option<Owner> = tracks.owner_of(world_m, timestamp_ns);
            returns.push(ProjectedReturn {
                pixel,
                range_m,
                world_m,
                origin_m: world_from_camera.translation_m,
                owner,
                occluded: false,
                source: DepthSource::Map,
                weight,
            });
        }
    }
    returns
}

fn on_edge(units: &[u16], width: usize, height: usize, column: usize, row: usize) -> bool {
    let at = row * width + column;
    let here = f64::from(units[at]);
    let neighbours = [
        (column > 0).then(|| at - 1),
        (column + 1 < width).then(|| at + 1),
        (row > 0).then(|| at - width),
        (row + 1 < height).then(|| at + width),
    ];
    neighbours.into_iter().flatten().any(|other| {
        let other = units[other];
        other != DEPTH_UNKNOWN && (f64::from(other) - here).abs() > EDGE * here
    })
}

#[cfg(test)]
mod tests {
    use backlot_engine::camera::Distortion;
    use glam::{DVec2, DVec3};

    use super::*;
    use crate::domain::blob::BlobRef;
    use crate::ingest::decompose_tests::street;

    fn camera() -> Camera {
        Camera {
            width: 64,
            height: 48,
            focal_px: DVec2::splat(40.0),
            principal_px: DVec2::new(32.0, 24.0),
            distortion: Distortion::None,
        }
    }

    fn returns(unit_m: f64, units: &[u16]) -> Vec<ProjectedReturn> {
        let (log, _) = street(true);
        let map = DepthMap {
            image: BlobRef::of(&[]),
            unit_m,
            kind: DepthMapKind::Stereo,
            weight: None,
        };
        map_returns(&log, 0, &map, units, &camera(), &Rigid::IDENTITY)
    }

    #[test]
    fn depth_is_along_the_axis_and_metric() {
        // A wall 10 m ahead, at right angles to the axis: every pixel has the same z, and another range.
        let wall = returns(0.01, &[1000; 64 * 48]);
        assert_eq!(wall.len(), 64 * 48);
        for r in &wall {
            assert!((r.world_m.z - 10.0).abs() < 1e-9, "{r:?}");
            assert!((r.range_m - r.world_m.length()).abs() < 1e-9, "{r:?}");
            assert_eq!((r.source, r.weight), (DepthSource::Map, STEREO_WEIGHT));
        }
        // Taken for ranges, the same numbers are no wall.
        let corner = &wall[0];
        let as_range = camera().direction(corner.pixel) * 10.0;
        assert!((as_range.z - 10.0).abs() > 1.0, "{as_range}");
        let DVec3 { x, y, .. } = corner.world_m;
        assert!(x < -7.0 && y < -5.0, "{corner:?}");
    }

    #[test]
    fn unknown_far_and_edge_pixels_say_nothing() {
        let mut units = vec![1000; 64 * 48];
        for row in units.chunks_exact_mut(64) {
            row[..16].fill(DEPTH_UNKNOWN);
            row[32..48].fill(2000);
            row[48..].fill(60_000);
        }
        let kept = returns(0.01, &units);
        let columns: std::collections::BTreeSet<u32> =
            kept.iter().map(|r| r.pixel.x as u32).collect();
        let expected = (16..31).chain(33..47);
        assert_eq!(columns, expected.collect());
    }
}
