//! Points of structure from motion as returns.

use backlot_engine::camera::{Camera, Rigid};
use backlot_engine::view::DepthSource;
use glam::{DVec2, DVec3};

use super::lidar::NearbyTracks;
use super::projected::{ProjectedReturn, mark_occluded};
use crate::domain::drive_log::{DriveLog, OBSERVATION_BYTES, SFM_POINT_BYTES, SfmPoints};

/// A triangulated point is wrong by a few percent of its range, and some are matched wrongly altogether.
const WEIGHT: f32 = 0.5;
/// Triangulation along a drive says little beyond this; points of wrong matches lie anywhere.
const REACH_M: f64 = 80.0;
/// Without observations: points within this many mean spacings are neighbours that may hide each other.
const NEIGHBOUR_SPACINGS: f64 = 1.5;

/// One image that saw a point.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Observation {
    /// Index of the point.
    pub point: u32,
    /// Index into the log's frames.
    pub frame: u32,
}

/// The points, finite or not, in the world frame.
pub(super) fn decode_sfm_points(bytes: &[u8]) -> impl Iterator<Item = DVec3> + '_ {
    bytes.chunks_exact(SFM_POINT_BYTES).map(|point| {
        let value = |axis: usize| {
            let number = &point[8 * axis..8 * axis + 8];
            f64::from_le_bytes(number.try_into().expect("eight bytes"))
        };
        DVec3::new(value(0), value(1), value(2))
    })
}

pub(super) fn decode_observations(bytes: &[u8]) -> impl Iterator<Item = Observation> + '_ {
    bytes.chunks_exact(OBSERVATION_BYTES).map(|pair| {
        let value = |at: usize| {
            let number = &pair[at..at + 4];
            u32::from_le_bytes(number.try_into().expect("four bytes"))
        };
        Observation {
            point: value(0),
            frame: value(4),
        }
    })
}

/// The points of a log.
#[derive(Debug)]
pub(super) struct SfmCloud {
    world_m: Vec<DVec3>,
    /// Points by frame, where the log says which frame saw which.
    seen_in: Option<Vec<Vec<u32>>>,
    weight: f32,
}

impl SfmCloud {
    /// From the content of its blobs, which validation let through.
    pub(super) fn new(
        sfm: &SfmPoints,
        points: &[u8],
        observations: Option<&[u8]>,
        frames: usize,
    ) -> Self {
        let world_m: Vec<DVec3> = decode_sfm_points(points).collect();
        let seen_in = observations.map(|bytes| {
            let mut seen_in = vec![Vec::new(); frames];
            for seen in decode_observations(bytes) {
                let known = (seen.point as usize) < world_m.len();
                if let (true, Some(points)) = (known, seen_in.get_mut(seen.frame as usize)) {
                    points.push(seen.point);
                }
            }
            seen_in
        });
        Self {
            world_m,
            seen_in,
            weight: sfm.weight.map_or(WEIGHT, |weight| weight as f32),
        }
    }

    /// The points that the frame at `index` of the log sees. What moves has none: it does not triangulate.
    pub(super) fn returns(
        &self,
        log: &DriveLog,
        index: usize,
        camera: &Camera,
        world_from_camera: &Rigid,
    ) -> Vec<ProjectedReturn> {
        let timestamp_ns = log.frames[index].timestamp_ns;
        let camera_from_world = world_from_camera.inverse();
        let size = DVec2::new(f64::from(camera.width), f64::from(camera.height));
        let tracks = NearbyTracks::standing_at(log, timestamp_ns);
        let place = |world_m: DVec3| {
            let camera_m = camera_from_world.point(world_m);
            let range_m = camera_m.length();
            let pixel = camera
                .project(camera_m)
                .filter(|p| p.cmpge(DVec2::ZERO).all() && p.cmplt(size).all())?;
            (range_m <= REACH_M).then(|| ProjectedReturn {
                pixel,
                range_m,
                world_m,
                origin_m: world_from_camera.translation_m,
                owner: tracks.owner_of(world_m, timestamp_ns),
                occluded: false,
                source: DepthSource::SfmPoint,
                weight: self.weight,
            })
        };
        match &self.seen_in {
            Some(seen_in) => {
                let points = seen_in[index].iter().map(|&i| self.world_m[i as usize]);
                points.filter_map(place).collect()
            }
            None => {
                let mut returns: Vec<_> = self.world_m.iter().copied().filter_map(place).collect();
                let spacing_px = (size.x * size.y / returns.len().max(1) as f64).sqrt();
                mark_occluded(&mut returns, camera, NEIGHBOUR_SPACINGS * spacing_px);
                returns
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::domain::blob::BlobRef;
    use crate::ingest::decompose_tests::street;

    fn bytes(points: &[DVec3]) -> Vec<u8> {
        let numbers = points.iter().flat_map(|p| p.to_array());
        numbers.flat_map(f64::to_le_bytes).collect()
    }

    fn returns(points: &[DVec3], observations: Option<&[[u32; 2]]>) -> Vec<ProjectedReturn> {
        let (log, _) = street(true);
        let sfm = SfmPoints {
            points: BlobRef::of(&[]),
            observations: None,
            weight: None,
        };
        let observations: Option<Vec<u8>> = observations.map(|pairs| {
            pairs
                .as_flattened()
                .iter()
                .flat_map(|v| v.to_le_bytes())
                .collect()
        });
        let frames = log.frames.len();
        let cloud = SfmCloud::new(&sfm, &bytes(points), observations.as_deref(), frames);
        let world_from_camera = log.world_from_camera(&log.frames[0]).unwrap();
        cloud.returns(&log, 0, &log.cameras[0].camera, &world_from_camera)
    }

    #[test]
    fn points_are_seen_where_the_log_says_so() {
        let points = [
            DVec3::new(12.0, 3.0, 0.75),
            DVec3::new(30.0, 0.0, 1.0),
            DVec3::new(500.0, 0.0, 1.0),
            DVec3::new(-5.0, 0.0, 1.0),
        ];
        let all = returns(&points, None);
        // The far one and the one behind the camera are left out.
        assert_eq!(all.len(), 2);
        assert_eq!(all[0].owner.map(|o| o.track), Some(0), "the parked car's");
        let range_m = (points[1] - DVec3::new(0.0, 0.0, 1.5)).length();
        assert!((all[1].range_m - range_m).abs() < 1e-9, "{:?}", all[1]);
        let seen = returns(&points, Some(&[[1, 0], [0, 3]]));
        assert_eq!(seen.len(), 1);
        assert_eq!(seen[0].world_m, points[1]);
        assert_eq!(
            (seen[0].source, seen[0].weight),
            (DepthSource::SfmPoint, WEIGHT)
        );
    }

    #[test]
    fn without_observations_points_behind_a_wall_are_hidden() {
        let wall = |x: f64| {
            (0..200).map(move |i| {
                let (u, v) = (f64::from(i % 20) / 20.0, f64::from(i / 20) / 10.0);
                DVec3::new(x, (u - 0.5) * x * 0.8, 1.5 + (v - 0.5) * x * 0.3)
            })
        };
        let points: Vec<DVec3> = wall(10.0).chain(wall(40.0)).collect();
        let seen = returns(&points, None);
        let (far, near): (Vec<&ProjectedReturn>, Vec<&ProjectedReturn>) =
            seen.iter().partition(|r| r.world_m.x > 20.0);
        assert!(near.len() > 150 && near.iter().all(|r| !r.occluded));
        let hidden = far.iter().filter(|r| r.occluded).count();
        // The rows at the upper and lower rim have nothing on one side.
        assert!(hidden * 10 > far.len() * 7, "{hidden} of {}", far.len());
    }
}
