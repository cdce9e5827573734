//! Pixels that carry nothing to train on: what a mover that was left out hid from the recorded image.

use glam::{DVec2, DVec3};

use super::collision::Occupied;
use super::composition::Composition;
use super::projection::amodal_box;
use super::render::RenderedFrame;
use crate::camera::Rigid;

/// Annotated boxes cut off mirrors and shadows at the wheels.
const PADDING_M: f64 = 0.25;
/// A surface this little before the left-out box counts as behind its front.
const DEPTH_TOLERANCE_M: f64 = 0.3;

/// 255 where a left-out mover was and nothing rendered now stands in front; `None` if there is no such pixel.
pub fn ignore_mask(composition: &Composition, frame: &RenderedFrame) -> Option<Vec<u8>> {
    let mut mask = vec![0u8; frame.instance.len()];
    let mut any = false;
    for mover in &composition.left_out {
        any |= cover(composition, frame, mover, &mut mask);
    }
    any.then_some(mask)
}

fn cover(
    composition: &Composition,
    frame: &RenderedFrame,
    mover: &Occupied,
    mask: &mut [u8],
) -> bool {
    let size_m = mover.size_m + DVec3::splat(2.0 * PADDING_M);
    let camera_from_cuboid = composition.local_from_camera.inverse() * mover.local_from_cuboid;
    let camera = &composition.camera;
    let Some(bounds) =
        amodal_box(camera, &camera_from_cuboid, size_m).and_then(|b| b.clipped(camera))
    else {
        return false;
    };
    let rendered = |instance: u16| {
        let of = |o: &&super::PlacedObject| o.instance_id == instance;
        let object = composition.objects.iter().find(of);
        object.is_some_and(|o| o.asset.is_some())
    };
    let mut any = false;
    for row in bounds.min.y as u32..libm::ceil(bounds.max.y) as u32 {
        for column in bounds.min.x as u32..libm::ceil(bounds.max.x) as u32 {
            let i = (row * frame.width + column) as usize;
            let pixel = DVec2::new(f64::from(column) + 0.5, f64::from(row) + 0.5);
            let direction = camera.direction(pixel);
            let Some(entry) = entry_m(&camera_from_cuboid, size_m, direction) else {
                continue;
            };
            let z = f64::from(frame.depth_z_m[i]);
            let behind = z == 0.0 || z >= entry * direction.z - DEPTH_TOLERANCE_M;
            if behind && !rendered(frame.instance[i]) {
                mask[i] = 255;
                any = true;
            }
        }
    }
    any
}

/// Distance at which a camera ray enters the box; 0 from inside.
fn entry_m(camera_from_cuboid: &Rigid, size_m: DVec3, direction: DVec3) -> Option<f64> {
    let cuboid_from_camera = camera_from_cuboid.inverse();
    let origin = cuboid_from_camera.translation_m;
    let inverse = cuboid_from_camera.direction(direction).recip();
    let (a, b) = (
        (-size_m * 0.5 - origin) * inverse,
        (size_m * 0.5 - origin) * inverse,
    );
    let enter = a.min(b).max_element().max(0.0);
    let leave = a.max(b).min_element();
    (enter < leave).then_some(enter)
}
