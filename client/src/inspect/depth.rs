//! What a log says about depth besides LiDAR, in figures and over its images.

use std::collections::BTreeMap;
use std::io;

use backlot_engine::camera::{Camera, Rigid};
use backlot_proto::v1;
use glam::{DVec2, DVec3};
use image::DynamicImage;
use serde::Serialize;

use crate::read_log::ReadLog;

/// Bytes of a point of structure from motion, and of an observation of one.
const POINT_BYTES: u64 = 24;
const OBSERVATION_BYTES: usize = 8;
/// One pixel of a map in so many is drawn, so that the image shows between them.
const SPACING_PX: usize = 6;

/// One source of depth.
#[derive(Clone, Debug, Serialize)]
pub struct DepthReport {
    /// "stereo maps", "monocular maps" or "SfM points".
    pub source: &'static str,
    /// Images that have it.
    pub images: usize,
    /// Points in all; 0 for maps.
    pub points: u64,
    /// Least and largest unit of the maps in millimetres of camera z.
    pub unit_mm: Option<[f64; 2]>,
    /// Weight against a LiDAR return that the log asks for; `None` is the default of the source.
    pub weight: Option<f64>,
}

/// Every source of depth besides LiDAR.
pub(super) fn depth_reports(log: &v1::DriveLog) -> Vec<DepthReport> {
    let mut maps: BTreeMap<&'static str, Vec<&v1::DepthMap>> = BTreeMap::new();
    for map in log.frames.iter().filter_map(|f| f.depth_map.as_ref()) {
        let source = match map.kind() {
            v1::DepthMapKind::Stereo => "stereo maps",
            _ => "monocular maps",
        };
        maps.entry(source).or_default().push(map);
    }
    let mut reports: Vec<DepthReport> = maps
        .into_iter()
        .map(|(source, maps)| {
            let units = maps.iter().map(|map| 1e3 * map.unit_m);
            let least = units.clone().fold(f64::INFINITY, f64::min);
            DepthReport {
                source,
                images: maps.len(),
                points: 0,
                unit_mm: Some([least, units.fold(0.0, f64::max)]),
                weight: Some(maps[0].weight).filter(|&weight| weight > 0.0),
            }
        })
        .collect();
    if let Some(sfm) = &log.sfm_points {
        let bytes = sfm.points.as_ref().map_or(0, |blob| blob.size_bytes);
        reports.push(DepthReport {
            source: "SfM points",
            images: log.frames.len(),
            points: bytes / POINT_BYTES,
            unit_mm: None,
            weight: Some(sfm.weight).filter(|&weight| weight > 0.0),
        });
    }
    reports
}

/// Pixels of the frame's depth map with their distance in metres; none without a map.
pub(super) fn map_points(
    log: &ReadLog,
    frame: &v1::CameraFrame,
    camera: &Camera,
) -> io::Result<Vec<(DVec2, f64)>> {
    let Some(map) = &frame.depth_map else {
        return Ok(Vec::new());
    };
    let content = read(log, map.image.as_ref())?;
    let invalid = |what: String| io::Error::new(io::ErrorKind::InvalidData, what);
    let units = match image::load_from_memory(&content) {
        Ok(DynamicImage::ImageLuma16(units)) => units,
        Ok(other) => {
            let what = format!("the depth map is {:?}, not 16-bit grey", other.color());
            return Err(invalid(what));
        }
        Err(e) => return Err(invalid(format!("the depth map does not decode: {e}"))),
    };
    if units.dimensions() != (camera.width, camera.height) {
        let (width, height) = units.dimensions();
        return Err(invalid(format!(
            "the depth map is {width}x{height}, differs from the camera's {}x{}",
            camera.width, camera.height
        )));
    }
    let known = units.enumerate_pixels().filter(|(x, y, unit)| {
        unit.0[0] > 0
            && (*x as usize).is_multiple_of(SPACING_PX)
            && (*y as usize).is_multiple_of(SPACING_PX)
    });
    let points = known.map(|(x, y, unit)| {
        let pixel = DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5);
        let z_m = f64::from(unit.0[0]) * map.unit_m;
        (pixel, z_m / camera.direction(pixel).z)
    });
    Ok(points.collect())
}

/// Pixels and distances in metres of the points that the frame saw; all in front of the camera if the log does not say which.
pub(super) fn sfm_points(
    log: &ReadLog,
    frame: &v1::CameraFrame,
    camera: &Camera,
    camera_from_world: &Rigid,
) -> io::Result<Vec<(DVec2, f64)>> {
    let Some(sfm) = &log.drive_log.sfm_points else {
        return Ok(Vec::new());
    };
    let content = read(log, sfm.points.as_ref())?;
    let place = |point: &[u8]| {
        let value = |axis: usize| {
            f64::from_le_bytes(point[8 * axis..8 * axis + 8].try_into().expect("8 bytes"))
        };
        let p = camera_from_world.point(DVec3::new(value(0), value(1), value(2)));
        Some((camera.project(p)?, p.length()))
    };
    let points: Vec<&[u8]> = content.chunks_exact(POINT_BYTES as usize).collect();
    let Some(observations) = &sfm.observations else {
        return Ok(points.into_iter().filter_map(place).collect());
    };
    let frames = &log.drive_log.frames;
    let own = frames
        .iter()
        .position(|f| (&f.camera_id, f.frame_index) == (&frame.camera_id, frame.frame_index));
    let observations = read(log, Some(observations))?;
    let seen = observations
        .chunks_exact(OBSERVATION_BYTES)
        .filter_map(|pair| {
            let value = |at: usize| {
                u32::from_le_bytes(pair[at..at + 4].try_into().expect("4 bytes")) as usize
            };
            points.get(value(0)).filter(|_| Some(value(4)) == own)
        });
    Ok(seen.filter_map(|point| place(point)).collect())
}

fn read(log: &ReadLog, blob: Option<&v1::BlobRef>) -> io::Result<bytes::Bytes> {
    let blob = blob.ok_or_else(|| io::Error::new(io::ErrorKind::InvalidData, "a blob is missing"));
    log.read_blob(blob?)
}
