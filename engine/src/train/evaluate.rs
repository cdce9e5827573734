//! Measures a trained field on held-out views.

use glam::DVec2;

use super::fit::Run;
use crate::field::{Field, Ray};
use crate::quality::{QualityReport, RenderedRay, psnr_db, render_rays, ssim};
use crate::view::{DepthReturn, DepthSource, PixelLabel, Split, TrainView};

/// Depth figures count returns up to here, and the best share of them.
const DEPTH_RANGE_M: f32 = 50.0;
const DEPTH_SHARE: f64 = 0.95;

/// Measures a background, or an object within its box. An object's accumulation figures fall back on its training views.
///
/// `backdrop` is the colour behind a bounded scene, which has no mask to be judged by.
pub(super) fn evaluate(
    field: &Field,
    views: &[TrainView],
    run: Run,
    backdrop: Option<[f32; 3]>,
) -> QualityReport {
    let mut sums = Sums {
        behind: backdrop.unwrap_or_default(),
        ..Sums::default()
    };
    let mut held_out: Vec<u32> = Vec::new();
    for view in views.iter().filter(|view| view.split == Split::HeldOut) {
        sums.add(field, view);
        held_out.push(view.frame_index);
    }
    held_out.sort_unstable();
    let masked = field.sky.is_none() && backdrop.is_none();
    let mut silhouettes = Sums::default();
    if held_out.is_empty() && masked {
        views.iter().for_each(|view| silhouettes.add(field, view));
    } else {
        silhouettes = sums.clone();
    }
    QualityReport {
        psnr_held_out: (sums.pixels > 0).then(|| psnr_db(sums.squared_error / sums.pixels as f64)),
        ssim_held_out: mean(&sums.ssims),
        depth_mae_m: best_mean(&mut sums.range_errors_m),
        train_views: views
            .iter()
            .filter(|view| view.split == Split::Train)
            .count() as u32,
        held_out_views: held_out.len() as u32,
        held_out_frames: held_out,
        accumulation_in_mask: masked.then(|| mean(&silhouettes.inside)).flatten(),
        halo: masked.then(|| mean(&silhouettes.around)).flatten(),
        train_seconds: run.seconds,
        train_rays: run.rays,
        psnr_train: run.psnr_train,
        voxel_size_m: f64::from(field.finest_voxel_m()),
        warnings: run.warnings,
    }
}

#[derive(Clone, Debug, Default)]
struct Sums {
    /// Colour behind a field that has no sky.
    behind: [f32; 3],
    squared_error: f64,
    pixels: u64,
    ssims: Vec<f64>,
    range_errors_m: Vec<f64>,
    /// Accumulation inside masks, and on background-labelled rays through the box.
    inside: Vec<f64>,
    around: Vec<f64>,
}

impl Sums {
    fn add(&mut self, field: &Field, view: &TrainView) {
        let (width, height) = (view.camera.width as usize, view.camera.height as usize);
        let (low, high) = field.bounds();
        // An object's rays outside its box show nothing and are not rendered.
        let through: Vec<(usize, Ray)> = (0..width * height)
            .filter(|at| view.labels[*at] != PixelLabel::Unknown)
            .map(|at| (at, view.pixel_ray(at)))
            .filter(|(_, ray)| field.sky.is_some() || ray.cross_box(low, high).is_some())
            .collect();
        let rays: Vec<Ray> = through.iter().map(|(_, ray)| *ray).collect();
        let nothing = RenderedRay {
            color: self.behind,
            ..RenderedRay::default()
        };
        let mut image = vec![nothing; width * height];
        for ((at, _), rendered) in through.iter().zip(render_rays(field, &rays)) {
            let left = 1.0 - rendered.accumulation;
            image[*at] = RenderedRay {
                color: std::array::from_fn(|c| rendered.color[c] + left * self.behind[c]),
                ..rendered
            };
            match view.labels[*at] {
                PixelLabel::Foreground => self.inside.push(f64::from(rendered.accumulation)),
                PixelLabel::Background => self.around.push(f64::from(rendered.accumulation)),
                _ => {}
            }
        }
        self.compare(view, &image);
        self.range_errors_m.extend(range_errors_m(field, view));
    }

    /// Colour errors over the pixels that belong to the field: not sky, not unknown.
    fn compare(&mut self, view: &TrainView, image: &[RenderedRay]) {
        let mask: Vec<bool> = view
            .labels
            .iter()
            .map(|l| *l == PixelLabel::Foreground)
            .collect();
        // Pictures have 8 bits, so that is what is compared.
        let predicted: Vec<[f32; 3]> = image
            .iter()
            .map(|ray| {
                ray.color
                    .map(|c| (c.clamp(0.0, 1.0) * 255.0).round() / 255.0)
            })
            .collect();
        let actual: Vec<[f32; 3]> = view
            .rgb
            .chunks_exact(3)
            .map(|c| [c[0], c[1], c[2]].map(|c| f32::from(c) / 255.0))
            .collect();
        for ((p, a), _) in predicted
            .iter()
            .zip(&actual)
            .zip(&mask)
            .filter(|(_, m)| **m)
        {
            self.squared_error += (0..3).map(|c| f64::from(p[c] - a[c]).powi(2)).sum::<f64>() / 3.0;
            self.pixels += 1;
        }
        let (width, height) = (view.camera.width as usize, view.camera.height as usize);
        self.ssims
            .extend(ssim(width, height, &predicted, &actual, &mask));
    }
}

/// Against LiDAR where the view has any, otherwise against what stands in for it.
fn range_errors_m(field: &Field, view: &TrainView) -> Vec<f64> {
    let is_measured = |d: &DepthReturn| d.source == DepthSource::Lidar;
    let only_measured = view.depth.iter().any(is_measured);
    let near: Vec<_> = view
        .depth
        .iter()
        .filter(|d| d.range_m <= DEPTH_RANGE_M && (!only_measured || is_measured(d)))
        .collect();
    let ray = |pixel: [f32; 2]| view.ray(DVec2::from(pixel.map(f64::from)));
    let rays: Vec<Ray> = near.iter().map(|depth| ray(depth.pixel)).collect();
    let rendered = render_rays(field, &rays);
    let errors = rendered.iter().zip(&near);
    errors
        .map(|(r, d)| f64::from((r.range_m - d.range_m).abs()))
        .collect()
}

fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

/// Mean of the best [`DEPTH_SHARE`] of the errors.
fn best_mean(errors: &mut Vec<f64>) -> Option<f64> {
    errors.sort_by(f64::total_cmp);
    errors.truncate((errors.len() as f64 * DEPTH_SHARE).ceil() as usize);
    mean(errors)
}
