//! LiDAR returns or other depths, and cuboids, drawn over an image: where they do not fit, calibration, poses or tracks are wrong.

use std::collections::BTreeMap;
use std::io;

use backlot_engine::camera::{Camera, Rigid};
use backlot_proto::v1;
use glam::{DVec2, DVec3};
use image::{Rgb, RgbImage};

use super::depth::{map_points, sfm_points};
use super::report::camera_from_world;
use crate::geometry::{camera_from_wire, rigid_from_wire, vector_from_wire};
use crate::motion::{ego_pose_at, track_pose_at};
use crate::picture::{GLYPH_HEIGHT, draw_cuboid, draw_text};
use crate::read_log::ReadLog;

/// Colours run from red at the first to blue at the second distance.
const NEAR_M: f64 = 4.0;
const FAR_M: f64 = 60.0;
/// Images wider than this have returns of two pixels.
const WIDE_PX: u32 = 1000;
/// Maps are drawn with gaps and points of structure from motion are few.
const SPARSE_SIDE_PX: i64 = 3;
const INK: Rgb<u8> = Rgb([255, 255, 255]);
const STRIP: Rgb<u8> = Rgb([24, 24, 28]);
const CAPTION_MARGIN_PX: u32 = 4;

/// Up to `count` frames of each camera, evenly spaced from the first to the last.
pub fn overlay_frames(log: &v1::DriveLog, count: usize) -> Vec<&v1::CameraFrame> {
    let mut by_camera: BTreeMap<&str, Vec<&v1::CameraFrame>> = BTreeMap::new();
    for frame in &log.frames {
        by_camera.entry(&frame.camera_id).or_default().push(frame);
    }
    let mut chosen = Vec::new();
    for frames in by_camera.values_mut() {
        frames.sort_by_key(|frame| frame.timestamp_ns);
        let count = count.min(frames.len());
        let steps = count.saturating_sub(1).max(1);
        chosen.extend((0..count).map(|i| frames[i * (frames.len() - 1) / steps]));
    }
    chosen
}

/// The image of a frame with the returns of each scanner's nearest sweep, its depth map and the points it saw, coloured by distance,
/// and the cuboids of its time.
///
/// # Errors
/// Those of reading a blob; an image that does not decode, a frame without a camera, or one outside the trajectory.
pub fn overlay(log: &ReadLog, frame: &v1::CameraFrame) -> io::Result<RgbImage> {
    let manifest = &log.drive_log;
    let unusable = |what: &str| io::Error::new(io::ErrorKind::InvalidData, what);
    let blob = frame
        .image
        .as_ref()
        .ok_or_else(|| unusable("the frame has no image"))?;
    let mut image = image::load_from_memory(&log.read_blob(blob)?)
        .map_err(|e| io::Error::new(io::ErrorKind::InvalidData, e))?
        .into_rgb8();
    let wire = manifest
        .cameras
        .iter()
        .find(|c| c.camera_id == frame.camera_id);
    let camera = wire.and_then(|wire| Some((wire, camera_from_wire(wire)?)));
    let (wire, camera) = camera.ok_or_else(|| unusable("the frame has no camera"))?;
    let camera_from_world = camera_from_world(manifest, wire, frame.timestamp_ns);
    let camera_from_world =
        camera_from_world.ok_or_else(|| unusable("the frame is outside the ego trajectory"))?;
    let mut caption = format!("{} FRAME {}", frame.camera_id, frame.frame_index);
    for sweep in nearest_sweeps(manifest, frame.timestamp_ns) {
        let late_ms = (sweep.timestamp_ns - frame.timestamp_ns) as f64 * 1e-6;
        caption += &format!("  {} {late_ms:+.0} MS", sweep.lidar_id);
        draw_sweep(&mut image, log, sweep, &camera, &camera_from_world)?;
    }
    let of_map = map_points(log, frame, &camera)?;
    let of_sfm = sfm_points(log, frame, &camera, &camera_from_world)?;
    for (name, points) in [("DEPTH MAP", of_map), ("SFM", of_sfm)] {
        if !points.is_empty() {
            caption += &format!("  {name}");
            draw_points(&mut image, points, SPARSE_SIDE_PX);
        }
    }
    draw_tracks(
        &mut image,
        manifest,
        frame.timestamp_ns,
        &camera,
        &camera_from_world,
    );
    draw_caption(&mut image, &caption);
    Ok(image)
}

/// A line of text on a dark strip along the top: skies are white.
fn draw_caption(image: &mut RgbImage, caption: &str) {
    let scale = if image.width() > WIDE_PX { 3 } else { 2 };
    let strip_px = (GLYPH_HEIGHT * scale + 2 * CAPTION_MARGIN_PX).min(image.height());
    for y in 0..strip_px {
        for x in 0..image.width() {
            image.put_pixel(x, y, STRIP);
        }
    }
    draw_text(
        image,
        CAPTION_MARGIN_PX,
        CAPTION_MARGIN_PX,
        scale,
        INK,
        caption,
    );
}

fn nearest_sweeps(log: &v1::DriveLog, timestamp_ns: i64) -> Vec<&v1::LidarSweep> {
    let mut nearest: BTreeMap<&str, &v1::LidarSweep> = BTreeMap::new();
    for sweep in &log.sweeps {
        let held = nearest.entry(&sweep.lidar_id).or_insert(sweep);
        if sweep.timestamp_ns.abs_diff(timestamp_ns) < held.timestamp_ns.abs_diff(timestamp_ns) {
            *held = sweep;
        }
    }
    nearest.into_values().collect()
}

fn draw_sweep(
    image: &mut RgbImage,
    log: &ReadLog,
    sweep: &v1::LidarSweep,
    camera: &Camera,
    camera_from_world: &Rigid,
) -> io::Result<()> {
    let Some(blob) = &sweep.points else {
        return Ok(());
    };
    let content = log.read_blob(blob)?;
    let poses = &log.drive_log.world_from_ego;
    let ego_from_lidar = rigid_from_wire(sweep.ego_from_lidar.as_ref());
    let timed = sweep.format() == v1::PointFormat::XyzitF32;
    let mut returns = Vec::new();
    for point in content.chunks_exact(if timed { 20 } else { 16 }) {
        let value =
            |k: usize| f32::from_le_bytes(point[4 * k..4 * k + 4].try_into().expect("4 bytes"));
        let delay_s = if timed { f64::from(value(4)) } else { 0.0 };
        let at = sweep.timestamp_ns.saturating_add((delay_s * 1e9) as i64);
        let Some(world_from_ego) = ego_pose_at(poses, at) else {
            continue;
        };
        let p = DVec3::new(value(0).into(), value(1).into(), value(2).into());
        let p_camera = (*camera_from_world * world_from_ego * ego_from_lidar).point(p);
        if let Some(pixel) = camera.project(p_camera) {
            returns.push((pixel, p_camera.length()));
        }
    }
    let side = if camera.width > WIDE_PX { 2 } else { 1 };
    draw_points(image, returns, side);
    Ok(())
}

fn draw_points(image: &mut RgbImage, mut points: Vec<(DVec2, f64)>, side: i64) {
    // Near ones last, so that they are seen.
    points.sort_by(|a, b| b.1.total_cmp(&a.1));
    for (pixel, distance_m) in points {
        draw_return(image, pixel, side, distance_color(distance_m));
    }
}

fn draw_return(image: &mut RgbImage, pixel: DVec2, side: i64, color: Rgb<u8>) {
    for dy in 0..side {
        for dx in 0..side {
            let (x, y) = (pixel.x.floor() as i64 + dx, pixel.y.floor() as i64 + dy);
            let inside = (0..i64::from(image.width())).contains(&x)
                && (0..i64::from(image.height())).contains(&y);
            if inside {
                image.put_pixel(x as u32, y as u32, color);
            }
        }
    }
}

fn draw_tracks(
    image: &mut RgbImage,
    log: &v1::DriveLog,
    timestamp_ns: i64,
    camera: &Camera,
    camera_from_world: &Rigid,
) {
    let size_px = DVec2::new(image.width().into(), image.height().into());
    for track in &log.tracks {
        let Some(pose) = track_pose_at(track, timestamp_ns) else {
            continue;
        };
        let camera_from_cuboid = *camera_from_world * pose;
        let size_m = vector_from_wire(track.size_m.as_ref());
        let color = class_color(track.object_class());
        draw_cuboid(image, camera, &camera_from_cuboid, size_m, color);
        let top = camera_from_cuboid.point(DVec3::Z * (size_m.z / 2.0));
        if let Some(at) = camera
            .project(top)
            .filter(|at| at.cmpge(DVec2::splat(12.0)).all() && at.cmplt(size_px).all())
        {
            let name: String = track.track_id.chars().take(8).collect();
            draw_text(image, at.x as u32, at.y as u32 - 12, 2, color, &name);
        }
    }
}

/// Colours that no return has.
fn class_color(class: v1::ObjectClass) -> Rgb<u8> {
    match class {
        v1::ObjectClass::Car | v1::ObjectClass::Van => Rgb([255, 60, 230]),
        v1::ObjectClass::Truck | v1::ObjectClass::Bus | v1::ObjectClass::Tram => {
            Rgb([255, 255, 255])
        }
        v1::ObjectClass::Pedestrian | v1::ObjectClass::Cyclist => Rgb([190, 110, 255]),
        v1::ObjectClass::Other | v1::ObjectClass::Unspecified => Rgb([170, 170, 170]),
    }
}

/// From red over yellow, green and cyan to blue, by the logarithm of the distance.
fn distance_color(distance_m: f64) -> Rgb<u8> {
    let share = (distance_m.max(NEAR_M) / NEAR_M).ln() / (FAR_M / NEAR_M).ln();
    let hue = 4.0 * share.min(1.0);
    let ramp = |from: f64| (255.0 * (2.0 - (hue - from).abs()).clamp(0.0, 1.0)) as u8;
    Rgb([ramp(0.0), ramp(2.0), ramp(4.0)])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::generator::{StreetConfig, StreetWorld};

    #[test]
    fn near_is_red_and_far_is_blue() {
        assert_eq!(distance_color(1.0), Rgb([255, 0, 0]));
        assert_eq!(distance_color(15.5).0[1], 255);
        assert_eq!(distance_color(200.0), Rgb([0, 0, 255]));
    }

    /// The returns on the lead car lie in its instance mask, which the generator draws with the same calibration.
    #[test]
    fn returns_of_an_object_lie_on_it() {
        let config = StreetConfig {
            frames: 2,
            width: 160,
            height: 96,
            travel_m: 4.0,
            supersample: 1,
            ..StreetConfig::default()
        };
        let log = StreetWorld::new(&config).unwrap().read_log().unwrap();
        let frame = &log.drive_log.frames[0];
        let mask = log
            .read_blob(frame.instance_mask.as_ref().unwrap())
            .unwrap();
        let mask = image::load_from_memory(&mask).unwrap().into_luma16();
        let plain = image::load_from_memory(&log.read_blob(frame.image.as_ref().unwrap()).unwrap());
        let plain = plain.unwrap().into_rgb8();
        let lead = log
            .drive_log
            .tracks
            .iter()
            .position(|t| t.track_id == "moving-00")
            .unwrap() as u16
            + 1;
        let without = ReadLog {
            drive_log: v1::DriveLog {
                tracks: Vec::new(),
                ..log.drive_log.clone()
            },
            blobs: log.blobs.clone(),
        };
        let drawn = overlay(&without, frame).unwrap();
        // Returns at the lead car's distance, about 13 m, are green; those of the street behind it are bluer.
        let (mut on_car, mut hits) = (0, 0);
        for (x, y, pixel) in drawn.enumerate_pixels() {
            if mask.get_pixel(x, y).0[0] == lead {
                on_car += 1;
                let near = pixel.0[2] < 40 && pixel.0[1] > 200;
                hits += usize::from(near && plain.get_pixel(x, y) != pixel);
            }
        }
        assert!(on_car > 100 && hits * 8 > on_car, "{hits} of {on_car}");
    }
}
