//! Original movers that no asset models, and the ground around those that one does, shown by the recorded image.
//!
//! A sample is rendered at a recorded camera pose, so the recorded image is right wherever nothing new stands in front. Under a
//! mover that was masked out of training the background was perhaps never seen at all; its recorded pixels are what was there.

use glam::DVec3;

use super::collision::Occupied;
use super::composition::{Composition, Origin, PlacedObject};
use super::frame::RenderedFrame;
use super::hull::{PADDING_M, for_each_pixel};
use super::projection::corners;
use super::recording::RecordedTrack;
use super::silhouette::{UNDERCARRIAGE_M, spread_px};
use crate::camera::{NEAR_M, Rigid};

/// The recorded image of the composition's frame: sRGB, row-major, three bytes a pixel, of any size.
#[derive(Clone, Copy, Debug)]
pub struct RecordedImage<'a> {
    pub width: u32,
    pub height: u32,
    pub rgb8: &'a [u8],
    /// What the log says of its pixels, if it does.
    pub masks: Option<InstanceMask<'a>>,
}

/// The instances of a recorded image, as large as it.
#[derive(Clone, Copy, Debug)]
pub struct InstanceMask<'a> {
    /// 0 where there is none, otherwise 1 + index into `tracks`; larger values name nobody.
    pub values: &'a [u16],
    pub tracks: &'a [RecordedTrack],
}

/// Room around a mover that shows the recorded image: training left the mover out together with its contact, so that the field's
/// own pixels there are guesses. Sideways and up, in metres.
const SURROUNDINGS_M: (f64, f64) = (0.8, 0.6);
/// The ground around the footprint that its shadow may lie on, in metres.
const SHADOW_REACH_M: f64 = 2.0;
const SLAB_M: f64 = 0.1;
/// Half the width of the transition into the field's own pixels, in metres at the mover, and its limits in pixels.
const FEATHER_M: f64 = 0.15;
const FEATHER_PX: (usize, usize) = (2, 12);
/// Half the width in pixels of the transitions at the edges of a mover.
const RIM_PX: usize = 2;
/// Masks are this wrong at their edges.
const MASK_EDGE_PX: usize = 2;
/// Placed objects reach this far out of their cuboids.
const OBJECT_MARGIN_M: f64 = 0.2;

/// Puts the recorded image behind the placed objects: wholly where a mover without an asset stands, and around every original mover,
/// those left out included, except in the `hidden` pixels that a left-out one took. Returns its weight per pixel.
///
/// Movers are cut out by the log's instance masks. Without one colours come from the padded cuboid's silhouette, because mirrors and
/// shadows reach out of annotated boxes; depth and instance from the cuboid itself. Call it before shadows are cast and labels are made.
///
/// # Panics
/// If `recorded.rgb8` is not of its size.
pub(super) fn show_recorded(
    composition: &Composition,
    recorded: &RecordedImage<'_>,
    hidden: &[bool],
    frame: &mut RenderedFrame,
) -> Vec<f32> {
    let pixels = recorded.width as usize * recorded.height as usize;
    assert_eq!(recorded.rgb8.len(), 3 * pixels, "three bytes a pixel");
    let mut weights = surroundings(composition, frame.width as usize);
    for (weight, hidden) in weights.iter_mut().zip(hidden) {
        if *hidden {
            *weight = 0.0;
        }
    }
    mix(recorded, &weights, frame);
    let movers = composition.objects.iter();
    for mover in movers.filter(|o| o.origin == Origin::Replayed) {
        show_rim(composition, recorded, mover, frame);
    }
    let movers = composition.objects.iter();
    for mover in movers.filter(|o| o.origin == Origin::Recorded) {
        show_mover(composition, recorded, hidden, mover, frame, &mut weights);
    }
    weights
}

/// Lets the recorded image run out over the rim of the hidden pixels, on what they were given instead; `shown` becomes its weight.
pub(super) fn blend_rim(
    recorded: &RecordedImage<'_>,
    hidden: &[bool],
    shown: &mut [f32],
    frame: &mut RenderedFrame,
) {
    let mut within: Vec<f32> = hidden.iter().map(|h| f32::from(u8::from(*h))).collect();
    soften(&mut within, frame.width as usize, RIM_PX);
    let rim = (0..hidden.len()).map(|i| if hidden[i] { 1.0 - within[i] } else { 0.0 });
    let rim: Vec<f32> = rim.collect();
    mix(recorded, &rim, frame);
    for (shown, rim) in shown.iter_mut().zip(rim) {
        *shown = shown.max(rim);
    }
}

fn mix(recorded: &RecordedImage<'_>, weights: &[f32], frame: &mut RenderedFrame) {
    for i in (0..weights.len()).filter(|i| weights[*i] > 0.0) {
        let (color, weight) = (recorded.at(frame.width, frame.height, i), weights[i]);
        let rendered = match frame.shows_behind(i) {
            true => frame.behind_rgb[i],
            false => color,
        };
        let mixed = std::array::from_fn(|c| rendered[c] + weight * (color[c] - rendered[c]));
        frame.set_behind(i, mixed);
    }
}

fn show_mover(
    composition: &Composition,
    recorded: &RecordedImage<'_>,
    hidden: &[bool],
    mover: &PlacedObject,
    frame: &mut RenderedFrame,
    weights: &mut [f32],
) {
    let placed_from = placed_from(composition, mover.instance_id);
    let (around, own_pixels) = extent(composition, recorded, mover);
    for (i, z_m) in around {
        if hidden[i] {
            continue;
        }
        let color = recorded.at(frame.width, frame.height, i);
        let owner = owner_in_front(composition, frame, i, z_m);
        // The edge of an object that does not own the pixel still stands before the mover.
        let edge = !is_placed(composition, frame.instance[i]) && f64::from(placed_from[i]) < z_m;
        if owner.is_some() || edge {
            frame.set_behind(i, color);
        } else {
            frame.set_layers(i, color, [0.0; 3], 0.0);
        }
        frame.behind_z_m[i] = z_m as f32;
        weights[i] = 1.0;
    }
    let mut alone_px = 0;
    for (i, z_m) in own_pixels {
        if !hidden[i] {
            alone_px += 1;
            own(composition, frame, mover.instance_id, i, z_m);
        }
    }
    frame.alone_px.push((mover.instance_id, alone_px));
}

/// Pixels with the camera z of the mover in them.
type Pixels = Vec<(usize, f64)>;

/// Where a mover's colours come from, and the pixels that it owns: from the log's mask, grown by its edge, or from its cuboid.
fn extent(
    composition: &Composition,
    recorded: &RecordedImage<'_>,
    mover: &PlacedObject,
) -> (Pixels, Pixels) {
    let camera = &composition.camera;
    let pose = composition.local_from_camera.inverse() * mover.local_from_object;
    let padded_m = mover.size_m + DVec3::splat(2.0 * PADDING_M);
    let (mut around, mut own) = (Vec::new(), Vec::new());
    for_each_pixel(camera, &pose, padded_m, |i, z_m| around.push((i, z_m)));
    let track_id = mover.track_id.as_deref().unwrap_or_default();
    let Some(mask) = recorded.mask_of(track_id, camera.width, camera.height) else {
        for_each_pixel(camera, &pose, mover.size_m, |i, z_m| own.push((i, z_m)));
        return (around, own);
    };
    let mut grown = mask.clone();
    spread_px(&mut grown, camera.width as usize, [MASK_EDGE_PX; 3]);
    around.retain(|(i, _)| grown[*i]);
    own.extend(around.iter().filter(|(i, _)| mask[*i]));
    (around, own)
}

/// Fades a replayed mover into its own recorded image where its asset knows least: at its rim, and where its wheels meet the ground.
fn show_rim(
    composition: &Composition,
    recorded: &RecordedImage<'_>,
    mover: &PlacedObject,
    frame: &mut RenderedFrame,
) {
    let camera = &composition.camera;
    let object_from_camera = mover.local_from_object.inverse() * composition.local_from_camera;
    let foot_m = UNDERCARRIAGE_M.1 - 0.5 * mover.size_m.z;
    let is_body = |i: usize| {
        let direction = camera.direction(frame.pixel_centre(i));
        let p = object_from_camera.point(direction * (f64::from(frame.depth_z_m[i]) / direction.z));
        frame.instance[i] == mover.instance_id && p.z > foot_m
    };
    let mut kept: Vec<f32> = (0..frame.instance.len())
        .map(|i| f32::from(u8::from(is_body(i))))
        .collect();
    soften(&mut kept, frame.width as usize, RIM_PX);
    let size_m = mover.size_m + DVec3::splat(2.0 * OBJECT_MARGIN_M);
    let camera_from_object = object_from_camera.inverse();
    let others = placed_from(composition, mover.instance_id);
    for_each_pixel(camera, &camera_from_object, size_m, |i, _| {
        // Where another object may show its edge, the two cannot be told apart.
        let own = frame.instance[i] == mover.instance_id || frame.instance[i] == 0;
        if own && others[i] == f32::INFINITY {
            let color = recorded.at(frame.width, frame.height, i);
            let keep = kept[i];
            let placed = frame.placed_rgb[i].map(|c| keep * c);
            let alpha = keep * frame.placed_alpha[i];
            frame.set_layers(i, color.map(|c| (1.0 - alpha) * c), placed, alpha);
        }
    });
}

/// Whether a composition cannot be shown without its frame's recorded image.
pub fn needs_recorded(composition: &Composition) -> bool {
    let mut objects = composition.objects.iter();
    objects.any(|o| matches!(o.origin, Origin::Recorded | Origin::Replayed))
}

/// Weight of the recorded image around the original movers: 1 near them, falling to 0 at the rim.
fn surroundings(composition: &Composition, width: usize) -> Vec<f32> {
    let camera = &composition.camera;
    let camera_from_local = composition.local_from_camera.inverse();
    let mut weights = vec![0.0f32; camera.pixel_count()];
    for mover in original_movers(composition) {
        let pose = camera_from_local * mover.local_from_cuboid;
        let mut mask = vec![0.0f32; weights.len()];
        let (aside_m, up_m) = SURROUNDINGS_M;
        let around_m = mover.size_m + 2.0 * DVec3::new(aside_m, aside_m, up_m);
        for_each_pixel(camera, &pose, around_m, |i, _| mask[i] = 1.0);
        let bottom = DVec3::Z * (-0.5 * mover.size_m.z);
        let ground = Rigid::new(pose.rotation, pose.point(bottom));
        let slab_m = (mover.size_m + DVec3::splat(2.0 * SHADOW_REACH_M)).with_z(SLAB_M);
        for_each_pixel(camera, &ground, slab_m, |i, _| mask[i] = 1.0);
        let nearest = corners(&pose, mover.size_m)
            .iter()
            .fold(f64::INFINITY, |z, corner| z.min(corner.z))
            .max(NEAR_M);
        let (least, most) = FEATHER_PX;
        let feather = libm::round(FEATHER_M * camera.focal_px.x / nearest) as usize;
        soften(&mut mask, width, feather.clamp(least, most));
        for (weight, own) in weights.iter_mut().zip(mask) {
            *weight = weight.max(own);
        }
    }
    weights
}

fn original_movers(composition: &Composition) -> impl Iterator<Item = Occupied> + '_ {
    let shown = composition.objects.iter();
    let shown = shown.filter(|o| matches!(o.origin, Origin::Replayed | Origin::Recorded));
    let left_out = composition.left_out.iter().map(|mover| mover.occupied);
    shown.map(PlacedObject::occupied).chain(left_out)
}

/// Turns a mask of zeros and ones into a weight that rises smoothly from the mask's rim inwards, over about twice `radius`.
fn soften(mask: &mut [f32], width: usize, radius: usize) {
    let height = mask.len() / width;
    let mut line = Vec::new();
    for row in mask.chunks_exact_mut(width) {
        line.clear();
        line.extend_from_slice(row);
        box_mean(&line, radius, |i, mean| row[i] = mean);
    }
    for column in 0..width {
        line.clear();
        line.extend((0..height).map(|row| mask[row * width + column]));
        box_mean(&line, radius, |row, mean| mask[row * width + column] = mean);
    }
    for value in mask {
        let t = (2.0 * *value - 1.0).clamp(0.0, 1.0);
        *value = t * t * (3.0 - 2.0 * t);
    }
}

/// Means of the window of `radius` around each element, cut off at the ends.
fn box_mean(line: &[f32], radius: usize, mut put: impl FnMut(usize, f32)) {
    let mut sums = Vec::with_capacity(line.len() + 1);
    sums.push(0.0f32);
    for value in line {
        sums.push(sums[sums.len() - 1] + value);
    }
    for i in 0..line.len() {
        let (from, to) = (i.saturating_sub(radius), (i + radius + 1).min(line.len()));
        put(i, (sums[to] - sums[from]) / (to - from) as f32);
    }
}

/// Camera z from which on a placed object other than `except` may be, per pixel.
fn placed_from(composition: &Composition, except: u16) -> Vec<f32> {
    let camera_from_local = composition.local_from_camera.inverse();
    let mut from = vec![f32::INFINITY; composition.camera.pixel_count()];
    let placed = |o: &&PlacedObject| o.asset.is_some() && o.instance_id != except;
    for object in composition.objects.iter().filter(placed) {
        let pose = camera_from_local * object.local_from_object;
        let size_m = object.size_m + DVec3::splat(2.0 * OBJECT_MARGIN_M);
        for_each_pixel(&composition.camera, &pose, size_m, |i, z_m| {
            from[i] = from[i].min(z_m as f32);
        });
    }
    from
}

/// Whether the instance is rendered from an asset.
pub(super) fn is_placed(composition: &Composition, instance: u16) -> bool {
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
    /// The pixels of a track in an image of another size; `None` if the log's masks show nothing of it.
    pub(super) fn mask_of(&self, track_id: &str, width: u32, height: u32) -> Option<Vec<bool>> {
        let masks = self.masks?;
        let index = masks.tracks.iter().position(|t| t.track_id == track_id)?;
        let nearest = |pixel: usize, size: u32, of: u32| {
            (2 * pixel as u64 + 1) * u64::from(of) / (2 * u64::from(size))
        };
        let mask: Vec<bool> = (0..width as usize * height as usize)
            .map(|i| {
                let column = nearest(i % width as usize, width, self.width);
                let row = nearest(i / width as usize, height, self.height);
                let value = masks.values[(row * u64::from(self.width) + column) as usize];
                usize::from(value) == index + 1
            })
            .collect();
        mask.contains(&true).then_some(mask)
    }

    /// Colour, 0..=1, at the centre of pixel `i` of an image of another size, bilinear.
    pub(super) fn at(&self, width: u32, height: u32, i: usize) -> [f32; 3] {
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
            ((top * (1.0 - fy) + bottom * fy) / 255.0) as f32
        })
    }
}
