//! Original movers that no asset models, and the ground around those that one does, shown by the recorded image.
//!
//! A sample is rendered at a recorded camera pose, so the recorded image is right wherever nothing new stands in front. Under a
//! mover that was masked out of training the background was perhaps never seen at all; its recorded pixels are what was there.

use glam::DVec3;

use super::composition::{Composition, Origin, PlacedObject};
use super::hull::for_each_pixel;
use super::ignore::PADDING_M;
use super::render::RenderedFrame;

/// The recorded image of the composition's frame: sRGB, row-major, three bytes a pixel, of any size.
#[derive(Clone, Copy, Debug)]
pub struct RecordedImage<'a> {
    pub width: u32,
    pub height: u32,
    pub rgb8: &'a [u8],
}

/// Room around a mover that training left out together with it, for its contact and shadow, in metres: sideways, up.
const SURROUNDINGS_M: (f64, f64) = (0.8, 0.4);

/// Puts the recorded movers of a composition over its rendered frame, behind whatever was placed nearer, and the recorded
/// surroundings around its replayed ones.
///
/// Colours come from the padded cuboid's silhouette, because mirrors and shadows reach out of annotated boxes; depth and instance
/// from the cuboid itself. Call it after shadows were cast and before labels are made.
///
/// # Panics
/// If `recorded.rgb8` is not of its size.
pub fn replay_recorded(
    composition: &Composition,
    recorded: &RecordedImage<'_>,
    frame: &mut RenderedFrame,
) {
    let pixels = recorded.width as usize * recorded.height as usize;
    assert_eq!(recorded.rgb8.len(), 3 * pixels, "three bytes a pixel");
    let camera_from_local = composition.local_from_camera.inverse();
    for mover in replayed(composition) {
        let (aside_m, up_m) = SURROUNDINGS_M;
        let size_m = mover.size_m + DVec3::new(2.0 * aside_m, 2.0 * aside_m, 2.0 * up_m);
        let camera_from_cuboid = camera_from_local * mover.local_from_object;
        for_each_pixel(&composition.camera, &camera_from_cuboid, size_m, |i, _| {
            if !is_placed(composition, frame.instance[i]) {
                let color = recorded.at(frame.width, frame.height, i);
                frame.rgb8[3 * i..3 * i + 3].copy_from_slice(&color);
            }
        });
    }
    let movers = composition.objects.iter();
    for mover in movers.filter(|o| o.origin == Origin::Recorded) {
        let camera_from_cuboid = camera_from_local * mover.local_from_object;
        let padded_m = mover.size_m + DVec3::splat(2.0 * PADDING_M);
        for_each_pixel(
            &composition.camera,
            &camera_from_cuboid,
            padded_m,
            |i, z_m| {
                if owner_in_front(composition, frame, i, z_m).is_none() {
                    let color = recorded.at(frame.width, frame.height, i);
                    frame.rgb8[3 * i..3 * i + 3].copy_from_slice(&color);
                }
            },
        );
        let mut alone_px = 0;
        for_each_pixel(
            &composition.camera,
            &camera_from_cuboid,
            mover.size_m,
            |i, z_m| {
                alone_px += 1;
                own(composition, frame, mover.instance_id, i, z_m);
            },
        );
        frame.alone_px.push((mover.instance_id, alone_px));
    }
}

/// Whether a composition needs its frame's recorded image.
pub fn needs_recorded(composition: &Composition) -> bool {
    let mut objects = composition.objects.iter();
    objects.any(|o| matches!(o.origin, Origin::Recorded | Origin::Replayed))
}

fn replayed(composition: &Composition) -> impl Iterator<Item = &PlacedObject> {
    let objects = composition.objects.iter();
    objects.filter(|o| o.origin == Origin::Replayed)
}

/// Whether the instance is rendered from an asset.
fn is_placed(composition: &Composition, instance: u16) -> bool {
    let mut objects = composition.objects.iter();
    objects.any(|o| o.instance_id == instance && o.asset.is_some())
}

/// Gives one pixel to a recorded mover, or counts who hides it there.
fn own(composition: &Composition, frame: &mut RenderedFrame, id: u16, i: usize, z_m: f64) {
    let owner = frame.instance[i];
    if let Some(front) = owner_in_front(composition, frame, i, z_m) {
        *frame.hidden_px.entry((id, front)).or_default() += 1;
        return;
    }
    if owner != 0 {
        *frame.hidden_px.entry((owner, id)).or_default() += 1;
    }
    frame.instance[i] = id;
    frame.depth_z_m[i] = z_m as f32;
    frame.accumulation[i] = 1.0;
}

/// The instance that stands before a surface at `z_m`. The bare background never does: where movers hid it from training its
/// depth means nothing, and a pole that truly stands there is in the recorded pixels.
fn owner_in_front(
    composition: &Composition,
    frame: &RenderedFrame,
    i: usize,
    z_m: f64,
) -> Option<u16> {
    let owner = frame.instance[i];
    let z = f64::from(frame.depth_z_m[i]);
    let known = |o: &&PlacedObject| o.instance_id == owner;
    let placed = composition.objects.iter().find(known)?;
    (z > 0.0 && z < z_m).then_some(placed.instance_id)
}

impl RecordedImage<'_> {
    /// Colour at the centre of pixel `i` of an image of another size, bilinear.
    fn at(&self, width: u32, height: u32, i: usize) -> [u8; 3] {
        let (column, row) = (i % width as usize, i / width as usize);
        let axis = |pixel: usize, size: u32, of: u32| {
            let at = (pixel as f64 + 0.5) * f64::from(of) / f64::from(size) - 0.5;
            let at = at.clamp(0.0, f64::from(of - 1));
            let low = at as usize;
            (low, (low + 1).min(of as usize - 1), at - low as f64)
        };
        let (x0, x1, fx) = axis(column, width, self.width);
        let (y0, y1, fy) = axis(row, height, self.height);
        let texel = |x: usize, y: usize, c: usize| {
            f64::from(self.rgb8[3 * (y * self.width as usize + x) + c])
        };
        std::array::from_fn(|c| {
            let top = texel(x0, y0, c) * (1.0 - fx) + texel(x1, y0, c) * fx;
            let bottom = texel(x0, y1, c) * (1.0 - fx) + texel(x1, y1, c) * fx;
            libm::round(top * (1.0 - fy) + bottom * fy) as u8
        })
    }
}
