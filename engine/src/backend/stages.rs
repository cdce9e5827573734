//! What each stage of a training step found, for comparing backends.

use crate::field::{FEATURES, RaySample};

/// The stages of one step's rays.
#[derive(Clone, Debug, Default)]
pub(in crate::backend) struct Stages {
    /// Samples of every ray, near to far.
    pub(in crate::backend) rays: Vec<Vec<StageSample>>,
    /// Gradients by every level's densities and features, all bricks.
    pub(in crate::backend) density: Vec<Vec<f32>>,
    pub(in crate::backend) features: Vec<Vec<[f32; FEATURES]>>,
    /// By the colour network's parameters.
    pub(in crate::backend) network: Vec<f32>,
    /// By the logits of all the sky's grids.
    pub(in crate::backend) sky: Vec<f32>,
    /// By every view's log gain, bias, rotation and translation, if views are corrected.
    pub(in crate::backend) views: Vec<[f32; 12]>,
    pub(in crate::backend) color_rays: u64,
    pub(in crate::backend) squared_error: f64,
    pub(in crate::backend) loss: f64,
}

impl Stages {
    /// Samples that matter to a colour ray.
    pub(in crate::backend) fn colored(&self) -> usize {
        let samples = self.rays.iter().flatten();
        samples.filter(|sample| sample.colored.is_some()).count()
    }
}

#[derive(Clone, Copy, Debug)]
pub(in crate::backend) struct StageSample {
    pub(in crate::backend) sample: RaySample,
    pub(in crate::backend) weight: f32,
    /// Gradient by the raw density.
    pub(in crate::backend) raw: f32,
    /// Of a sample that matters to a colour ray.
    pub(in crate::backend) colored: Option<StageColor>,
}

#[derive(Clone, Copy, Debug)]
pub(in crate::backend) struct StageColor {
    pub(in crate::backend) features: [f32; FEATURES],
    pub(in crate::backend) color: [f32; 3],
    pub(in crate::backend) feature_gradient: [f32; FEATURES],
}
