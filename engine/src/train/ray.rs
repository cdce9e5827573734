//! One supervised ray, the unit every backend trains on.

use crate::field::Ray;

/// What fills the transmittance that a ray has left.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Backdrop {
    /// The field's sky map, which then learns too.
    Sky,
    /// The field's sky map, which does not learn from this ray.
    SkyAsIs,
    /// A fixed colour.
    Color([f32; 3]),
}

/// What is known about whether a ray hits the field.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Silhouette {
    Unknown,
    /// It hits: accumulation should be 1.
    Opaque,
    /// It passes: accumulation should be 0.
    Transparent,
}

/// A ray with its targets. Weights hold the loss's weight and the batch mean's divisor; 0 switches a target off.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrainRay {
    pub ray: Ray,
    /// Where in each interval density is read, 0..1.
    pub phase: f32,
    /// Marching ends here, in metres.
    pub t_max: f32,
    /// sRGB.
    pub color: [f32; 3],
    pub color_weight: f32,
    pub backdrop: Backdrop,
    pub silhouette: Silhouette,
    pub silhouette_weight: f32,
    /// LiDAR range along the ray in metres.
    pub range_m: f32,
    pub range_weight: f32,
}

/// Weights of the losses that every colour ray carries, relative to its `color_weight`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RayLosses {
    /// DVGO's per-sample colour loss.
    pub sample_color: f32,
    /// DVGO's entropy of the remaining transmittance.
    pub entropy: f32,
    /// Metres at which the depth loss turns from quadratic to linear.
    pub depth_scale_m: f32,
    /// Largest error in metres a sample of a depth ray is charged.
    pub depth_cap_m: f32,
    /// Samples of lighter weight take no part in colour.
    pub min_weight: f32,
    /// Expected range errors above this are outliers and left out.
    pub depth_trim_m: f32,
}

/// Learning rates of one step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rates {
    pub density: f32,
    pub features: f32,
    pub mlp: f32,
    pub sky: f32,
}

/// Sums over the rays of one step.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StepSums {
    pub color_rays: u64,
    /// Sum of the colour rays' mean squared errors.
    pub squared_error: f64,
    /// Weighted sum of all losses.
    pub loss: f64,
    /// Samples marched, and those coloured.
    pub samples: u64,
    pub colored: u64,
    /// Expected range error of every depth ray in metres.
    pub range_errors_m: Vec<f32>,
}

impl StepSums {
    pub fn clear(&mut self) {
        let mut errors = std::mem::take(&mut self.range_errors_m);
        errors.clear();
        *self = Self {
            range_errors_m: errors,
            ..Self::default()
        };
    }

    pub fn add(&mut self, other: &Self) {
        self.color_rays += other.color_rays;
        self.squared_error += other.squared_error;
        self.loss += other.loss;
        self.samples += other.samples;
        self.colored += other.colored;
        self.range_errors_m.extend_from_slice(&other.range_errors_m);
    }
}
