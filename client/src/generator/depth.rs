//! Depth that a log without a scanner brings: monocular maps, and points of structure from motion, with the errors such have.

use std::collections::BTreeMap;

use glam::{DVec2, DVec3};
use rayon::prelude::*;

use super::bvh::Ray;
use super::config::Error;
use super::noise::{gaussian, unit};
use super::render::{ExactFrame, ShadowCasters};
use super::world::StreetWorld;

/// Networks give up on what is farther.
const MAP_REACH_M: f32 = 120.0;
/// Standard deviations, as parts of the depth: of a whole map's scale, and of a pixel.
const MAP_SCALE_ERROR: f64 = 0.02;
const MAP_PIXEL_ERROR: f64 = 0.02;

/// Corners that a matcher follows from each image.
const CORNERS: u32 = 400;
/// Nearer points are matched in at least this many images.
const LEAST_OBSERVATIONS: usize = 3;
/// A point is followed through images this many frames on.
const FOLLOWED_FRAMES: usize = 12;
const POINT_REACH_M: f64 = 60.0;
/// The standard deviation of a triangulated range grows with its square: half a pixel over a baseline of five metres.
const POINT_ERROR_PER_M: f64 = 2e-4;
/// Share of points that were matched wrongly and lie anywhere along their ray.
const OUTLIERS: f32 = 0.01;
/// A surface this close to a point, as part of the distance, is the point's.
const SAME_SURFACE: f64 = 0.005;

/// The units of a depth map and their size in metres; sky and what is too far are 0.
pub(super) fn depth_units(exact: &ExactFrame, index: u32, seed: u32) -> (Vec<u16>, f64) {
    let known = |z: f32| z.is_finite() && z < MAP_REACH_M;
    let scale = 1.0 + MAP_SCALE_ERROR * gaussian(index, seed, 201);
    let stream = seed ^ index.wrapping_mul(0x9e37_79b1);
    let depths: Vec<f64> = (0u32..)
        .zip(&exact.depth_z_m)
        .map(|(at, &z)| {
            let error = 1.0 + MAP_PIXEL_ERROR * gaussian(at, stream, 202);
            if known(z) {
                f64::from(z) * scale * error
            } else {
                0.0
            }
        })
        .collect();
    // The whole range of 16 bits, as a network's output is stored: another unit for every image.
    let farthest = depths.iter().copied().fold(1.0, f64::max);
    let unit_m = farthest / f64::from(u16::MAX);
    let units = depths.iter().map(|z| (z / unit_m).round() as u16);
    (units.collect(), unit_m)
}

/// A triangulated point and the frames that saw it.
struct SfmPoint {
    world_m: DVec3,
    frames: Vec<u32>,
}

/// The content of the two blobs of the wire form: points, and observations.
pub(super) struct SfmContent {
    pub(super) points: Vec<u8>,
    pub(super) observations: Vec<u8>,
}

impl StreetWorld {
    /// What structure from motion makes of frames taken at these times: static corners that at least three of them saw.
    pub(super) fn triangulate(&self, timestamps: &[i64]) -> Result<SfmContent, Error> {
        let found: Vec<Vec<SfmPoint>> = (0..timestamps.len())
            .into_par_iter()
            .map(|first| self.points_from(timestamps, first))
            .collect::<Result<_, Error>>()?;
        let mut content = SfmContent {
            points: Vec::new(),
            observations: Vec::new(),
        };
        for (number, point) in (0u32..).zip(found.iter().flatten()) {
            let numbers = point.world_m.to_array();
            content
                .points
                .extend(numbers.iter().flat_map(|v| v.to_le_bytes()));
            for frame in &point.frames {
                content.observations.extend(number.to_le_bytes());
                content.observations.extend(frame.to_le_bytes());
            }
        }
        Ok(content)
    }

    /// Points whose first image is number `first`.
    fn points_from(&self, timestamps: &[i64], first: usize) -> Result<Vec<SfmPoint>, Error> {
        let last = timestamps.len().min(first + FOLLOWED_FRAMES);
        let camera = self.camera();
        let size = DVec2::new(f64::from(camera.width), f64::from(camera.height));
        let stream = self.seed() ^ (first as u32).wrapping_mul(0x85eb_ca77);
        let mut seen: BTreeMap<u32, SfmPoint> = BTreeMap::new();
        for (number, &timestamp_ns) in timestamps.iter().enumerate().take(last).skip(first) {
            let scene = self.scene(&self.actors_at(timestamp_ns), &ShadowCasters::None)?;
            let view = self.view_at(timestamp_ns);
            let origin_m = view.world_from_camera.translation_m;
            let range_m = |direction: DVec3| {
                let ray = Ray {
                    origin: origin_m.as_vec3(),
                    direction: direction.as_vec3(),
                };
                scene.nearest(&ray).map(|hit| f64::from(hit.t))
            };
            if number == first {
                for corner in 0..CORNERS {
                    let at = DVec2::new(
                        f64::from(unit(corner, stream, 1)),
                        f64::from(unit(corner, stream, 2)),
                    );
                    let along = camera.direction(at * size);
                    let direction = view.world_from_camera.direction(along);
                    if let Some(t) = range_m(direction).filter(|&t| t < POINT_REACH_M) {
                        let point = SfmPoint {
                            world_m: origin_m + direction * t,
                            frames: vec![number as u32],
                        };
                        seen.insert(corner, point);
                    }
                }
                continue;
            }
            for point in seen.values_mut() {
                let offset = point.world_m - origin_m;
                let distance_m = offset.length();
                let pixel = camera.project(view.world_from_camera.inverse().point(point.world_m));
                let inside =
                    pixel.is_some_and(|p| p.cmpge(DVec2::ZERO).all() && p.cmplt(size).all());
                let is_same = |t: f64| (t - distance_m).abs() < SAME_SURFACE * distance_m;
                if inside && range_m(offset / distance_m).is_some_and(is_same) {
                    point.frames.push(number as u32);
                }
            }
        }
        let origin_m = self
            .view_at(timestamps[first])
            .world_from_camera
            .translation_m;
        let kept = seen
            .into_iter()
            .filter(|(_, point)| point.frames.len() >= LEAST_OBSERVATIONS);
        Ok(kept
            .map(|(corner, point)| SfmPoint {
                world_m: blurred(point.world_m, origin_m, corner, stream),
                ..point
            })
            .collect())
    }
}

/// The point with the error of its range as seen from `origin_m`.
fn blurred(world_m: DVec3, origin_m: DVec3, corner: u32, stream: u32) -> DVec3 {
    let offset = world_m - origin_m;
    let range_m = offset.length();
    let factor = if unit(corner, stream, 3) < OUTLIERS {
        0.5 + f64::from(unit(corner, stream, 4))
    } else {
        1.0 + POINT_ERROR_PER_M * range_m * gaussian(corner, stream, 5)
    };
    origin_m + offset * factor
}

#[cfg(test)]
mod tests {
    use super::super::{DepthRecording, StreetConfig};
    use super::*;
    use crate::read_log::ReadLog;

    fn recorded(depth: DepthRecording) -> (StreetWorld, ReadLog) {
        let world = StreetWorld::new(&StreetConfig {
            frames: 6,
            travel_m: 8.0,
            width: 96,
            height: 64,
            supersample: 1,
            depth,
            ..StreetConfig::default()
        })
        .unwrap();
        let log = world.read_log().unwrap();
        (world, log)
    }

    #[test]
    fn a_log_has_the_depth_it_was_asked_for() {
        for (depth, sweeps, maps, points) in [
            (DepthRecording::Lidar, true, 0, false),
            (DepthRecording::Maps, false, 6, false),
            (DepthRecording::Points, false, 0, true),
            (DepthRecording::None, false, 0, false),
        ] {
            let log = recorded(depth).1.drive_log;
            let with_map = log.frames.iter().filter(|f| f.depth_map.is_some());
            assert_eq!(!log.sweeps.is_empty(), sweeps, "{depth:?}");
            assert_eq!(with_map.count(), maps, "{depth:?}");
            assert_eq!(log.sfm_points.is_some(), points, "{depth:?}");
        }
    }

    /// Pixels of the first frame whose depth is off by more than a twelfth, if a unit is taken for `factor` of it.
    fn wrong_pixels(factor: f64) -> f64 {
        let (world, log) = recorded(DepthRecording::Maps);
        let frame = &log.drive_log.frames[0];
        let map = frame.depth_map.as_ref().unwrap();
        let content = log.read_blob(map.image.as_ref().unwrap()).unwrap();
        let units = image::load_from_memory(&content).unwrap().into_luma16();
        let exact = world.frame_at(frame.timestamp_ns).unwrap();
        let known: Vec<_> = exact
            .depth_z_m
            .iter()
            .zip(units.as_raw())
            .filter(|(z, _)| z.is_finite() && **z < MAP_REACH_M)
            .collect();
        let wrong = known.iter().filter(|(z, unit)| {
            let z = f64::from(**z);
            (f64::from(**unit) * map.unit_m * factor - z).abs() > z / 12.0
        });
        assert!(known.len() > 3_000);
        wrong.count() as f64 / known.len() as f64
    }

    #[test]
    fn maps_are_metric_with_their_units() {
        assert!(wrong_pixels(1.0) < 0.02, "{}", wrong_pixels(1.0));
        assert!(wrong_pixels(1.2) > 0.9, "{}", wrong_pixels(1.2));
    }

    #[test]
    fn points_lie_on_what_their_observers_see() {
        let (world, log) = recorded(DepthRecording::Points);
        let sfm = log.drive_log.sfm_points.as_ref().unwrap();
        let points = log.read_blob(sfm.points.as_ref().unwrap()).unwrap();
        let seen = log.read_blob(sfm.observations.as_ref().unwrap()).unwrap();
        let off = |frame_shift: usize| {
            let (mut off, mut count) = (0, 0);
            for pair in seen.chunks_exact(8) {
                let value =
                    |at: usize| u32::from_le_bytes(pair[at..at + 4].try_into().unwrap()) as usize;
                let point = &points[24 * value(0)..];
                let axis =
                    |k: usize| f64::from_le_bytes(point[8 * k..8 * k + 8].try_into().unwrap());
                let p = DVec3::new(axis(0), axis(1), axis(2));
                let frames = &log.drive_log.frames;
                let at_ns = frames[(value(4) + frame_shift) % frames.len()].timestamp_ns;
                let view = world.view_at(at_ns);
                let scene = world
                    .scene(&world.actors_at(at_ns), &ShadowCasters::None)
                    .unwrap();
                let offset = p - view.world_from_camera.translation_m;
                let ray = Ray {
                    origin: view.world_from_camera.translation_m.as_vec3(),
                    direction: offset.normalize().as_vec3(),
                };
                let t = scene
                    .nearest(&ray)
                    .map_or(f64::INFINITY, |hit| f64::from(hit.t));
                count += 1;
                off += usize::from((t - offset.length()).abs() > 0.08 * t);
            }
            assert!(count > 1_000, "{count}");
            f64::from(off as u32) / f64::from(count as u32)
        };
        assert!(off(0) < 0.05, "{}", off(0));
        assert!(
            off(3) > 2.0 * off(0),
            "other frames do not see them: {}",
            off(3)
        );
    }
}
