//! How many views see each node of the coarse grid.

use glam::Vec3;
use rayon::prelude::*;

use super::grid::Shape;
use super::march::Medium;
use super::pixels::Pixels;
use crate::view::TrainView;

/// Rays this many to a voxel's width count a node as well as all rays would.
const RAYS_PER_VOXEL: f64 = 2.0;

/// For every node of the medium, the views of which the samples' trilinear weights at it sum to more than 1.
///
/// The recipe sends a ray through every pixel. Where several pixels fall on one voxel every k-th row and column is sent and
/// counts k^2-fold.
pub(super) fn count_views(pixels: &Pixels<'_>, medium: &Medium<'_>) -> Vec<u16> {
    let shape = medium.shape;
    let views = pixels.views();
    views
        .par_iter()
        .fold(
            || (vec![0u16; shape.len()], vec![0.0f32; shape.len()]),
            |(mut count, mut weights), view| {
                weights.fill(0.0);
                splat_view(pixels, view, medium, &mut weights);
                let seen = count.iter_mut().zip(&weights);
                seen.for_each(|(count, weight)| *count += u16::from(*weight > 1.0));
                (count, weights)
            },
        )
        .map(|(count, _)| count)
        .reduce(
            || vec![0; shape.len()],
            |mut a, b| {
                a.iter_mut().zip(&b).for_each(|(a, b)| *a += b);
                a
            },
        )
}

fn splat_view(pixels: &Pixels<'_>, view: &TrainView, medium: &Medium<'_>, weights: &mut [f32]) {
    let stride = stride_px(medium.shape, view);
    let share = (stride * stride) as f32;
    for y in (0..view.camera.height).step_by(stride) {
        for x in (0..view.camera.width).step_by(stride) {
            let ray = pixels.ray(view, x, y);
            medium.for_each_masked(ray.ray, ray.near_m, |q: Vec3| {
                let cell = medium.shape.cell(q);
                for (at, weight) in cell.corners().into_iter().zip(cell.weights()) {
                    weights[at as usize] += share * weight;
                }
                true
            });
        }
    }
}

/// The most pixels between rays that are still [`RAYS_PER_VOXEL`] at the box's far corner.
fn stride_px(shape: &Shape, view: &TrainView) -> usize {
    let eye = view.local_from_camera.translation_m;
    let (a, b) = ((shape.low - eye).abs(), (shape.high - eye).abs());
    let reach_m = a.max(b).length();
    let pixel_m = reach_m / view.camera.focal_px.max_element();
    let voxel_m = shape.spacing_m().min_element();
    (voxel_m / (RAYS_PER_VOXEL * pixel_m)).floor().max(1.0) as usize
}
