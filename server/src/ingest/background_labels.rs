//! What each pixel is to a background: static scene, sky, or nothing to learn from.

use backlot_engine::camera::Rigid;
use backlot_engine::view::PixelLabel;
use glam::{DVec2, DVec3};

use super::frame::LoadedFrame;
use super::hull::{convex_hull, corners, cuboid_hull, raster};
use super::movers::is_moving;
use super::raster::dilate;
use super::sky::find_sky;
use crate::domain::drive_log::{DriveLog, MASK_UNKNOWN};

/// Masks are grown by this many pixels per 640 of image width: their edges are mixed pixels and segmentation noise.
const MASK_MARGIN_PER_640_PX: usize = 2;
/// Without a mask the projected cuboid is masked, grown by this on every side.
const CUBOID_MARGIN_M: f64 = 0.2;
/// A mover darkens the ground around its footprint.
const CONTACT_SHADOW_M: f64 = 0.4;
/// A sun lower than this casts shadows longer than the pictures show.
const LEAST_SUN_ELEVATION: f64 = 0.15;

/// The tracks that move, by index into the log's tracks.
pub(crate) fn moving_tracks(log: &DriveLog) -> Vec<bool> {
    log.tracks.iter().map(is_moving).collect()
}

/// Labels of a frame's pixels, row-major. Movers and the shadows under them are unknown; parked cars are part of the scene.
pub(super) fn background_labels(
    log: &DriveLog,
    moving: &[bool],
    loaded: &LoadedFrame,
) -> Vec<PixelLabel> {
    let unknown = unknown_pixels(log, moving, loaded);
    let sky = match &loaded.sky {
        Some(mask) => mask.iter().map(|&v| v == u8::MAX).collect(),
        None => find_sky(
            &loaded.rgb,
            &loaded.camera,
            &loaded.world_from_camera,
            &loaded.returns,
        ),
    };
    unknown
        .into_iter()
        .zip(sky)
        .map(|label| match label {
            (true, _) => PixelLabel::Unknown,
            (false, true) => PixelLabel::Sky,
            (false, false) => PixelLabel::Foreground,
        })
        .collect()
}

fn unknown_pixels(log: &DriveLog, moving: &[bool], loaded: &LoadedFrame) -> Vec<bool> {
    let width = loaded.camera.width as usize;
    let mut unknown = vec![false; loaded.camera.pixel_count()];
    let mut masked = vec![false; log.tracks.len()];
    if let Some(instance) = &loaded.instance {
        for (pixel, &value) in unknown.iter_mut().zip(instance) {
            let track = usize::from(value).checked_sub(1);
            let is_mover = track.is_some_and(|t| moving.get(t) == Some(&true));
            *pixel = value == MASK_UNKNOWN || is_mover;
            if let Some(seen) = track.and_then(|t| masked.get_mut(t)) {
                *seen = true;
            }
        }
        let margin = (MASK_MARGIN_PER_640_PX * width).div_ceil(640);
        unknown = dilate(&unknown, width, margin);
    }
    let camera_from_world = loaded.world_from_camera.inverse();
    for (index, track) in log.tracks.iter().enumerate().filter(|(i, _)| moving[*i]) {
        let Some(world_from_cuboid) = track.at(loaded.frame.timestamp_ns) else {
            continue;
        };
        let camera_from_cuboid = camera_from_world * world_from_cuboid;
        if !masked[index] {
            let grown = track.size_m + DVec3::splat(2.0 * CUBOID_MARGIN_M);
            let hull = cuboid_hull(&loaded.camera, &camera_from_cuboid, grown);
            fill(&mut unknown, &hull, loaded);
        }
        let contact = contact_slab(&camera_from_cuboid, track.size_m);
        let hull = cuboid_hull(&loaded.camera, &contact.0, contact.1);
        fill(&mut unknown, &hull, loaded);
        if let Some(sun) = log.sun_direction_world {
            let shadow = shadow_corners(&world_from_cuboid, track.size_m, sun);
            let hull = outline(&shadow, &camera_from_world, loaded);
            fill(&mut unknown, &hull, loaded);
        }
    }
    unknown
}

fn fill(mask: &mut [bool], hull: &[DVec2], loaded: &LoadedFrame) {
    let (width, height) = (loaded.camera.width, loaded.camera.height);
    raster(hull, width, height, |row, columns| {
        mask[row * width as usize..][columns].fill(true);
    });
}

/// A flat cuboid on the ground around the footprint: pose and size.
fn contact_slab(camera_from_cuboid: &Rigid, size_m: DVec3) -> (Rigid, DVec3) {
    let lowered = DVec3::new(0.0, 0.0, -size_m.z / 2.0);
    let pose = Rigid::new(
        camera_from_cuboid.rotation,
        camera_from_cuboid.point(lowered),
    );
    let margin = 2.0 * CONTACT_SHADOW_M;
    (pose, DVec3::new(size_m.x + margin, size_m.y + margin, 0.1))
}

/// Where the cuboid's corners throw their shadow on the level of its bottom, with the bottom itself.
fn shadow_corners(world_from_cuboid: &Rigid, size_m: DVec3, sun: DVec3) -> Vec<DVec3> {
    if sun.z < LEAST_SUN_ELEVATION {
        return Vec::new();
    }
    let corners = corners(world_from_cuboid, size_m);
    let ground_z = corners.iter().map(|c| c.z).fold(f64::INFINITY, f64::min);
    corners
        .iter()
        .map(|&c| c - sun * ((c.z - ground_z) / sun.z))
        .collect()
}

/// Hull of the points in front of the camera: shadows partly behind it are cut roughly, which only keeps more pixels.
fn outline(points: &[DVec3], camera_from_world: &Rigid, loaded: &LoadedFrame) -> Vec<DVec2> {
    let pixels = points
        .iter()
        .filter_map(|&p| loaded.camera.project(camera_from_world.point(p)))
        .collect();
    convex_hull(pixels)
}
