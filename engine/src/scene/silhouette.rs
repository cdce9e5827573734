//! Which pixels of the recorded image an original mover may have hidden.

use glam::DVec3;
use rayon::prelude::*;

use super::collision::Occupied;
use super::hull::{PADDING_M, for_each_pixel};
use crate::camera::{Camera, NEAR_M, Rigid};
use crate::field::{Field, RaySample};

/// Mirrors, aerials and the blur of the model's own edge reach this far out of it: sideways, up, down, in metres.
const REACH_M: (f64, f64, f64) = (0.07, 0.1, 0.05);
/// Nothing of a mover is further out of its cuboid.
const LOOSE_CUBOID_M: f64 = 0.4;
/// Heights above the ground between which a model may lack wheels and sills: training could not tell them from their shadow.
pub(super) const UNDERCARRIAGE_M: (f64, f64) = (0.12, 0.4);
/// Less is the haze in the band that training could not judge.
const VISIBLE_TAU: f32 = 0.5;

/// What is known of a mover's shape in the image.
#[derive(Clone, Copy, Debug)]
pub(super) enum Shape<'a> {
    /// The log's own instance mask, row-major.
    Mask(&'a [bool]),
    /// Its asset's field.
    Model(&'a Field),
    Cuboid,
}

impl<'a> Shape<'a> {
    /// The best that there is.
    pub(super) fn best(mask: Option<&'a [bool]>, model: Option<&'a Field>) -> Self {
        let model = model.map_or(Self::Cuboid, Self::Model);
        mask.map_or(model, Self::Mask)
    }
}

/// Camera z in metres at which the mover may begin, per pixel, row-major; infinite where it hid nothing.
///
/// With a mask or a model of it (its own asset), these are the pixels in which it shows, with its surroundings of mirrors and contact;
/// without either, its padded cuboid.
pub(super) fn silhouette(
    camera: &Camera,
    camera_from_local: &Rigid,
    mover: &Occupied,
    shape: Shape<'_>,
) -> Vec<f32> {
    let camera_from_mover = *camera_from_local * mover.local_from_cuboid;
    let padding_m = match shape {
        Shape::Cuboid => PADDING_M,
        _ => LOOSE_CUBOID_M,
    };
    let mut begins = vec![f32::INFINITY; camera.pixel_count()];
    let padded_m = mover.size_m + DVec3::splat(2.0 * padding_m);
    for_each_pixel(camera, &camera_from_mover, padded_m, |i, z_m| {
        begins[i] = z_m as f32;
    });
    let mut covered = match shape {
        Shape::Cuboid => return begins,
        Shape::Mask(mask) => mask.to_vec(),
        Shape::Model(field) => visible(camera, &camera_from_mover, field, &begins),
    };
    grow(&mut covered, camera, &camera_from_mover, mover.size_m);
    let (low_m, high_m) = UNDERCARRIAGE_M;
    let middle = DVec3::Z * (0.5 * (low_m + high_m - mover.size_m.z));
    let undercarriage = Rigid::new(camera_from_mover.rotation, camera_from_mover.point(middle));
    let slab_m = mover.size_m.with_z(high_m - low_m);
    for_each_pixel(camera, &undercarriage, slab_m, |i, _| covered[i] = true);
    for (begin, covered) in begins.iter_mut().zip(covered) {
        if !covered {
            *begin = f32::INFINITY;
        }
    }
    begins
}

/// Pixels among the finite ones of `begins` whose ray loses light in the field.
fn visible(camera: &Camera, camera_from_mover: &Rigid, field: &Field, begins: &[f32]) -> Vec<bool> {
    let mover_from_camera = camera_from_mover.inverse();
    let origin = mover_from_camera.translation_m.as_vec3();
    let sees = |samples: &mut Vec<RaySample>, i: usize| {
        let pixel = camera.pixel_centre(i);
        let direction = mover_from_camera
            .direction(camera.direction(pixel))
            .as_vec3();
        samples.clear();
        field.march(origin, direction, 0.0, f32::INFINITY, VISIBLE_TAU, samples) >= VISIBLE_TAU
    };
    (0..begins.len())
        .into_par_iter()
        .map_init(Vec::new, |samples, i| {
            begins[i].is_finite() && sees(samples, i)
        })
        .collect()
}

/// Grows the covered pixels by [`REACH_M`] at the mover's nearest side.
fn grow(covered: &mut [bool], camera: &Camera, camera_from_mover: &Rigid, size_m: DVec3) {
    let nearest = super::projection::corners(camera_from_mover, size_m)
        .iter()
        .map(|corner| corner.z)
        .fold(f64::INFINITY, f64::min)
        .max(NEAR_M);
    let (width, height) = (camera.width as usize, camera.height as usize);
    let px = |m: f64, focal: f64, most: usize| (libm::ceil(m * focal / nearest) as usize).min(most);
    let (aside_m, up_m, down_m) = REACH_M;
    let aside = px(aside_m, camera.focal_px.x, width);
    let up = px(up_m, camera.focal_px.y, height);
    let down = px(down_m, camera.focal_px.y, height);
    spread_px(covered, width, [aside, up, down]);
}

/// Grows a mask by so many pixels: sideways, up, down.
pub(super) fn spread_px(covered: &mut [bool], width: usize, [aside, up, down]: [usize; 3]) {
    let height = covered.len() / width;
    let mut line = Vec::new();
    for row in covered.chunks_exact_mut(width) {
        line.clear();
        line.extend_from_slice(row);
        spread(&line, aside, aside, |i| row[i] = true);
    }
    for column in 0..width {
        line.clear();
        line.extend((0..height).map(|row| covered[row * width + column]));
        spread(&line, up, down, |row| covered[row * width + column] = true);
    }
}

/// Marks everything up to `before` before and `after` after a set element.
fn spread(line: &[bool], before: usize, after: usize, mut mark: impl FnMut(usize)) {
    let mut marked = 0;
    for i in (0..line.len()).filter(|i| line[*i]) {
        let end = (i + after + 1).min(line.len());
        for j in i.saturating_sub(before).max(marked)..end {
            mark(j);
        }
        marked = end;
    }
}
