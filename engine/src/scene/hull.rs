//! The pixels that a cuboid covers.

use glam::DVec3;

use super::projection::amodal_box;
use crate::camera::{Camera, Rigid};

/// Annotated boxes cut off mirrors and shadows at the wheels by about this.
pub(super) const PADDING_M: f64 = 0.25;

/// Calls `visit(pixel, z)` for every pixel whose centre's ray enters the cuboid, with the camera z of the entry in metres
/// (0 from inside); pixels are numbered row-major.
pub(super) fn for_each_pixel(
    camera: &Camera,
    camera_from_cuboid: &Rigid,
    size_m: DVec3,
    mut visit: impl FnMut(usize, f64),
) {
    let Some(bounds) =
        amodal_box(camera, camera_from_cuboid, size_m).and_then(|b| b.clipped(camera))
    else {
        return;
    };
    let cuboid_from_camera = camera_from_cuboid.inverse();
    for row in bounds.min.y as u32..libm::ceil(bounds.max.y) as u32 {
        for column in bounds.min.x as u32..libm::ceil(bounds.max.x) as u32 {
            let pixel = glam::DVec2::new(f64::from(column) + 0.5, f64::from(row) + 0.5);
            let direction = camera.direction(pixel);
            if let Some(entry) = entry_m(&cuboid_from_camera, size_m, DVec3::ZERO, direction) {
                visit((row * camera.width + column) as usize, entry * direction.z);
            }
        }
    }
}

/// Distance at which the ray enters the box; 0 from inside, `None` if it misses. The ray is in the source frame of
/// `cuboid_from_source`.
pub(super) fn entry_m(
    cuboid_from_source: &Rigid,
    size_m: DVec3,
    origin: DVec3,
    direction: DVec3,
) -> Option<f64> {
    let origin = cuboid_from_source.point(origin);
    let inverse = cuboid_from_source.direction(direction).recip();
    let (a, b) = (
        (-size_m * 0.5 - origin) * inverse,
        (size_m * 0.5 - origin) * inverse,
    );
    let enter = a.min(b).max_element().max(0.0);
    let leave = a.max(b).min_element();
    (enter < leave).then_some(enter)
}
