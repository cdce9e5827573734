//! How well an object's field keeps to the object, on views whose labels are true.

use super::{psnr_db, render_rays};
use crate::field::{Field, Ray};
use crate::view::{PixelLabel, TrainView};

/// An object's figures over all pixels of some views.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SilhouetteFigures {
    /// Inside the mask, in dB.
    pub psnr: f64,
    /// Mean accumulation of rays through the box that miss the object.
    pub halo: f64,
    /// Mean accumulation of rays that hit it.
    pub opacity: f64,
}

impl SilhouetteFigures {
    /// Every pixel that is not `Foreground` is taken to miss the object. A figure without a pixel is NaN.
    pub fn of(field: &Field, views: &[TrainView]) -> Self {
        let (mut error, mut inside, mut around) = (Vec::new(), Vec::new(), Vec::new());
        let (low, high) = field.bounds();
        for view in views {
            let pixels = 0..view.labels.len();
            let rays: Vec<Ray> = pixels.map(|at| view.pixel_ray(at)).collect();
            for ((at, ray), shown) in rays.iter().enumerate().zip(render_rays(field, &rays)) {
                let accumulation = f64::from(shown.accumulation);
                if view.labels[at] == PixelLabel::Foreground {
                    let recorded = &view.rgb[3 * at..3 * at + 3];
                    let pairs = shown.color.iter().zip(recorded);
                    let squares =
                        pairs.map(|(a, b)| (f64::from(*a) - f64::from(*b) / 255.0).powi(2));
                    error.push(squares.sum::<f64>() / 3.0);
                    inside.push(accumulation);
                } else if ray.cross_box(low, high).is_some() {
                    around.push(accumulation);
                }
            }
        }
        let mean = |x: &[f64]| x.iter().sum::<f64>() / x.len() as f64;
        Self {
            psnr: psnr_db(mean(&error)),
            halo: mean(&around),
            opacity: mean(&inside),
        }
    }
}
