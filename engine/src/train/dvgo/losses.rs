//! Losses of one ray and their gradients by its samples.

use std::ops::Range;

use super::recipe::StepRecipe;
use crate::volume;

/// What the losses of a step need besides a ray.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LossSetting {
    /// One over the rays of a step.
    pub(crate) ray_share: f32,
    pub(crate) entropy: f32,
    pub(crate) sample_color: f32,
    /// sRGB behind the scene.
    pub(crate) backdrop: [f32; 3],
}

impl LossSetting {
    pub(super) fn new(recipe: &StepRecipe, backdrop: [f32; 3]) -> Self {
        Self {
            ray_share: 1.0 / recipe.rays as f32,
            entropy: recipe.entropy,
            sample_color: recipe.sample_color,
            backdrop,
        }
    }
}

/// The samples of a ray that are coloured: consecutive slots of the batch.
#[derive(Debug)]
pub(super) struct RayColors<'a> {
    pub(super) slots: Range<usize>,
    /// sRGB of every slot of the batch, rows of `stride` values.
    pub(super) colors: &'a [f32],
    pub(super) gradients: &'a mut [f32],
    pub(super) stride: usize,
}

/// Squared error (mean over channels) and weighted loss of one ray, as the batch mean counts them.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct RayLoss {
    pub(super) squared_error: f32,
    pub(super) loss: f32,
}

/// Differentiates one ray: mean squared error + entropy of what light is left + every sample's own colour error.
///
/// `weights` are those of all the ray's samples and `shown` tells which have a slot; `end` is the light left. Adds the gradient
/// by optical depth to `tau_gradients` and writes that by the slots' colours.
#[inline(always)]
pub(super) fn differentiate_ray(
    setting: &LossSetting,
    target: [f32; 3],
    (weights, shown, end): (&[f32], &[bool], f32),
    batch: RayColors<'_>,
    weight_gradients: &mut [f32],
    tau_gradients: &mut [f32],
) -> RayLoss {
    let first = batch.slots.start * batch.stride;
    let rows = &batch.colors[first..batch.slots.end * batch.stride];
    let lit = || weights.iter().zip(shown).filter(|(_, shown)| **shown);
    let mut color = setting.backdrop.map(|c| c * end);
    for ((weight, _), row) in lit().zip(rows.chunks_exact(batch.stride)) {
        (0..3).for_each(|c| color[c] += weight * row[c]);
    }
    let mse = volume::color_loss(color, target);
    let by_color = mse.gradient.map(|g| g * setting.ray_share);
    let entropy = volume::entropy_loss(end);
    let mut loss = mse.value + setting.entropy * entropy.value;

    let own_share = setting.sample_color * setting.ray_share;
    let mut slot = first;
    for ((weight, shown), gradient) in weights.iter().zip(shown).zip(weight_gradients.iter_mut()) {
        *gradient = 0.0;
        if *shown {
            let row = &batch.colors[slot..slot + 3];
            let sample = [row[0], row[1], row[2]];
            let own = volume::sample_color_loss(*weight, sample, target);
            loss += setting.sample_color * own.value;
            let out = &mut batch.gradients[slot..slot + 3];
            (0..3).for_each(|c| out[c] = weight * by_color[c] + own_share * own.gradient[c]);
            *gradient = dot(by_color, sample);
            slot += batch.stride;
        }
    }
    let by_end =
        dot(by_color, setting.backdrop) + setting.ray_share * setting.entropy * entropy.gradient;
    volume::add_optical_depth_gradient(weights, weight_gradients, end, by_end, tau_gradients);
    RayLoss {
        squared_error: mse.value,
        loss: loss * setting.ray_share,
    }
}

#[inline(always)]
fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}
