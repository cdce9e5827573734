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
    /// The view it belongs to, whose exposure and pose correction apply.
    pub view: u32,
    /// Reflected about the x-z plane; a pose correction applies to the ray it was reflected from.
    pub mirrored: bool,
}

/// What the rectified loss is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Rectified {
    /// Binary cross-entropy: opaque rays gain density, transparent ones lose it.
    #[default]
    CrossEntropy,
    /// As the paper prints it, `-ln P` for every ray with a silhouette: density only rises. For ablation.
    Printed,
}

/// What the depth loss is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum DepthForm {
    /// Expected robust error of the ray's samples, each charged at most the cap.
    #[default]
    Expected,
    /// The paper's: L1 of the composited range, with the remainder at the cap behind the return.
    CompositedL1,
}

/// Weights of the losses that every colour ray carries, relative to its `color_weight`, and the forms of the others.
/// Whatever is 0 costs nothing; the default is all off.
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
    /// Range errors above this are outliers and left out.
    pub depth_trim_m: f32,
    pub depth: DepthForm,
    pub rectified: Rectified,
    /// The distortion loss of mip-NeRF 360, in the coordinate `t / (t + distortion_scale_m)`.
    pub distortion: f32,
    pub distortion_scale_m: f32,
    /// Total variation of densities and of features between neighbouring nodes, on the bricks a step touches; relative to
    /// the learning rates of the two.
    pub density_variation: f32,
    pub feature_variation: f32,
    /// How strongly views' exposures and poses are drawn to the recorded ones; they are free only while their rates are not 0.
    pub exposure_prior: f32,
    pub pose_prior: f32,
}

impl Default for RayLosses {
    fn default() -> Self {
        Self {
            sample_color: 0.0,
            entropy: 0.0,
            depth_scale_m: 0.1,
            depth_cap_m: 1.0,
            min_weight: 0.0,
            depth_trim_m: f32::INFINITY,
            depth: DepthForm::default(),
            rectified: Rectified::default(),
            distortion: 0.0,
            distortion_scale_m: 10.0,
            density_variation: 0.0,
            feature_variation: 0.0,
            exposure_prior: 0.0,
            pose_prior: 0.0,
        }
    }
}

/// Learning rates of one step. A rate of 0 leaves its parameters as they are.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Rates {
    pub density: f32,
    pub features: f32,
    pub mlp: f32,
    pub sky: f32,
    /// Of every view's exposure: log gain and bias.
    pub exposure: f32,
    /// Of every view's pose correction, in metres; rotations move by as many radians per two metres.
    pub pose_m: f32,
}

impl Rates {
    /// All rates times `factor`.
    pub fn scaled(self, factor: f32) -> Self {
        Self {
            density: self.density * factor,
            features: self.features * factor,
            mlp: self.mlp * factor,
            sky: self.sky * factor,
            exposure: self.exposure * factor,
            pose_m: self.pose_m * factor,
        }
    }
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
