//! Pixels that carry nothing to train on: what a mover that was left out hid from the recorded image.

use glam::DVec3;

use super::collision::Occupied;
use super::composition::Composition;
use super::hull::for_each_pixel;
use super::render::RenderedFrame;

/// Annotated boxes cut off mirrors and shadows at the wheels.
pub(super) const PADDING_M: f64 = 0.25;
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
    let rendered = |instance: u16| {
        let of = |o: &&super::PlacedObject| o.instance_id == instance;
        let object = composition.objects.iter().find(of);
        object.is_some_and(|o| o.asset.is_some())
    };
    let mut any = false;
    for_each_pixel(
        &composition.camera,
        &camera_from_cuboid,
        size_m,
        |i, entry_z_m| {
            let z = f64::from(frame.depth_z_m[i]);
            let behind = z == 0.0 || z >= entry_z_m - DEPTH_TOLERANCE_M;
            if behind && !rendered(frame.instance[i]) {
                mask[i] = 255;
                any = true;
            }
        },
    );
    any
}
