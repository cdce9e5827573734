//! The colour network over a batch of samples, forward and backward.
//!
//! Samples are grouped by ray. The view's share of the first layer is the same for all samples of a ray and is computed
//! once per ray, which leaves 12 of 39 inputs per sample.

use super::lanes::Lanes;
use super::matmul::{Finish, add_product, add_transposed_product};
use super::simd::{Simd, dispatch};
use crate::field::activation::sigmoid;
use crate::field::lattice::FEATURES;
use crate::field::mlp::{ColorMlp, MLP_OUTPUTS, MlpLayout};
use crate::field::view_encoding::VIEW_INPUTS;

/// Features per sample, padded to whole vectors; the last four are 0.
pub(crate) const PADDED_FEATURES: usize = 16;

/// Transposed copies of the weights, which the backward pass reads.
#[derive(Clone, Debug)]
pub(crate) struct TransposedWeights {
    layout: MlpLayout,
    /// Rows of W1 that belong to features, transposed: `[width][16]`.
    w1_transposed: Vec<f32>,
    w2_transposed: Vec<f32>,
    w3_transposed: Vec<f32>,
}

/// Inputs, activations and gradients of a batch. Grows to the largest batch seen and is then reused.
#[derive(Clone, Debug, Default)]
pub(crate) struct MlpBatch {
    /// `[sample][16]`.
    pub(crate) features: Vec<f32>,
    /// `[ray][27]`.
    pub(crate) views: Vec<f32>,
    /// End of each ray's samples.
    pub(crate) ray_ends: Vec<u32>,
    /// sRGB after the logistic, `[sample][4]`.
    pub(crate) colors: Vec<f32>,
    /// Gradient by `colors`, `[sample][4]`, written by the caller; overwritten by the backward pass.
    pub(crate) color_gradients: Vec<f32>,
    /// Gradient by `features`, `[sample][16]`.
    pub(crate) feature_gradients: Vec<f32>,
    /// Gradient by the parameters; the backward pass adds to it.
    pub(crate) parameter_gradients: Vec<f32>,
    rays: Vec<f32>,
    hidden1: Vec<f32>,
    hidden2: Vec<f32>,
    gradient1: Vec<f32>,
    gradient2: Vec<f32>,
}

impl TransposedWeights {
    pub(crate) fn new(mlp: &ColorMlp) -> Self {
        let mut weights = Self {
            layout: mlp.layout(),
            w1_transposed: Vec::new(),
            w2_transposed: Vec::new(),
            w3_transposed: Vec::new(),
        };
        weights.update(mlp);
        weights
    }

    /// Copies changed parameters.
    pub(crate) fn update(&mut self, mlp: &ColorMlp) {
        let (width, layout, p) = (mlp.width(), mlp.layout(), mlp.parameters());
        let w1 = &p[layout.w1()][..FEATURES * width];
        transpose(w1, width, PADDED_FEATURES, &mut self.w1_transposed);
        transpose(&p[layout.w2()], width, width, &mut self.w2_transposed);
        transpose(&p[layout.w3()], MLP_OUTPUTS, width, &mut self.w3_transposed);
    }
}

/// Writes the transpose of a matrix with rows of `columns`, its rows padded with zeros to `padded`.
fn transpose(matrix: &[f32], columns: usize, padded: usize, out: &mut Vec<f32>) {
    out.clear();
    out.resize(columns * padded, 0.0);
    for (r, row) in matrix.chunks_exact(columns).enumerate() {
        for (c, value) in row.iter().enumerate() {
            out[c * padded + r] = *value;
        }
    }
}

impl MlpBatch {
    pub(crate) fn clear(&mut self) {
        self.features.clear();
        self.views.clear();
        self.ray_ends.clear();
    }

    pub(crate) fn sample_count(&self) -> usize {
        self.features.len() / PADDED_FEATURES
    }

    pub(crate) fn color(&self, sample: usize) -> [f32; 3] {
        let c = &self.colors[sample * MLP_OUTPUTS..][..3];
        [c[0], c[1], c[2]]
    }

    /// Computes `colors`.
    pub(crate) fn forward(&mut self, mlp: &ColorMlp, simd: Simd) {
        forward(simd, mlp, self);
    }

    /// From `color_gradients`, computes `feature_gradients` and adds to `parameter_gradients`. Needs the activations of [`Self::forward`].
    pub(crate) fn backward(&mut self, weights: &TransposedWeights, simd: Simd) {
        backward(simd, weights, self);
    }
}

dispatch!(fn forward => forward_generic(mlp: &ColorMlp, batch: &mut MlpBatch));
dispatch!(fn backward => backward_generic(weights: &TransposedWeights, batch: &mut MlpBatch));

fn resize(buffer: &mut Vec<f32>, len: usize) {
    buffer.clear();
    buffer.resize(len, 0.0);
}

#[inline(always)]
fn forward_generic<L: Lanes, const R: usize, const V: usize>(mlp: &ColorMlp, batch: &mut MlpBatch) {
    let (layout, p) = (mlp.layout(), mlp.parameters());
    let width = layout.width;
    let (samples, rays) = (batch.sample_count(), batch.ray_ends.len());
    let (w1_features, w1_views) = p[layout.w1()].split_at(FEATURES * width);

    resize(&mut batch.rays, rays * width);
    fill_rows(&mut batch.rays, &p[layout.b1()]);
    let shape = (rays, width, VIEW_INPUTS);
    let (views, out) = (&batch.views, &mut batch.rays);
    add_product::<L, R, V>(shape, views, VIEW_INPUTS, w1_views, out, Finish::Keep);

    resize(&mut batch.hidden1, samples * width);
    let mut start = 0;
    for (end, bias) in batch.ray_ends.iter().zip(batch.rays.chunks_exact(width)) {
        let end = *end as usize * width;
        fill_rows(&mut batch.hidden1[start..end], bias);
        start = end;
    }
    let shape = (samples, width, FEATURES);
    let (features, out) = (&batch.features, &mut batch.hidden1);
    add_product::<L, R, V>(
        shape,
        features,
        PADDED_FEATURES,
        w1_features,
        out,
        Finish::Relu,
    );

    resize(&mut batch.hidden2, samples * width);
    fill_rows(&mut batch.hidden2, &p[layout.b2()]);
    let shape = (samples, width, width);
    let (input, out) = (&batch.hidden1, &mut batch.hidden2);
    add_product::<L, R, V>(shape, input, width, &p[layout.w2()], out, Finish::Relu);

    resize(&mut batch.colors, samples * MLP_OUTPUTS);
    fill_rows(&mut batch.colors, &p[layout.b3()]);
    let shape = (samples, MLP_OUTPUTS, width);
    let (input, out) = (&batch.hidden2, &mut batch.colors);
    add_product::<L, R, V>(shape, input, width, &p[layout.w3()], out, Finish::Keep);
    batch.colors.iter_mut().for_each(|x| *x = sigmoid(*x));
}

#[inline(always)]
fn backward_generic<L: Lanes, const R: usize, const V: usize>(
    weights: &TransposedWeights,
    batch: &mut MlpBatch,
) {
    let layout = weights.layout;
    let width = layout.width;
    let (samples, rays) = (batch.sample_count(), batch.ray_ends.len());
    if batch.parameter_gradients.len() != layout.len() {
        resize(&mut batch.parameter_gradients, layout.len());
    }
    let gradients = &mut batch.parameter_gradients;

    // Through the logistic: c (1 - c).
    let pairs = batch.color_gradients.iter_mut().zip(&batch.colors);
    pairs.for_each(|(g, c)| *g *= c * (1.0 - c));
    let out = &batch.color_gradients;
    let shape = (samples, width, MLP_OUTPUTS);
    let w3 = &mut gradients[layout.w3()];
    add_transposed_product::<L, R, V>(shape, &batch.hidden2, width, out, w3);
    add_rows(out, &mut gradients[layout.b3()]);

    resize(&mut batch.gradient2, samples * width);
    let to = &mut batch.gradient2;
    let from = &weights.w3_transposed;
    add_product::<L, R, V>(
        (samples, width, MLP_OUTPUTS),
        out,
        MLP_OUTPUTS,
        from,
        to,
        Finish::Keep,
    );
    through_relu(&mut batch.gradient2, &batch.hidden2);
    let shape = (samples, width, width);
    let w2 = &mut gradients[layout.w2()];
    add_transposed_product::<L, R, V>(shape, &batch.hidden1, width, &batch.gradient2, w2);
    add_rows(&batch.gradient2, &mut gradients[layout.b2()]);

    resize(&mut batch.gradient1, samples * width);
    let (from, to) = (&batch.gradient2, &mut batch.gradient1);
    add_product::<L, R, V>(shape, from, width, &weights.w2_transposed, to, Finish::Keep);
    through_relu(&mut batch.gradient1, &batch.hidden1);

    let (w1_features, w1_views) = gradients[layout.w1()].split_at_mut(FEATURES * width);
    let shape = (samples, FEATURES, width);
    let (input, from) = (&batch.features, &batch.gradient1);
    add_transposed_product::<L, R, V>(shape, input, PADDED_FEATURES, from, w1_features);
    resize(&mut batch.rays, rays * width);
    let mut start = 0;
    for (end, sum) in batch
        .ray_ends
        .iter()
        .zip(batch.rays.chunks_exact_mut(width))
    {
        let end = *end as usize * width;
        add_rows(&batch.gradient1[start..end], sum);
        start = end;
    }
    let shape = (rays, VIEW_INPUTS, width);
    add_transposed_product::<L, R, V>(shape, &batch.views, VIEW_INPUTS, &batch.rays, w1_views);
    add_rows(&batch.rays, &mut gradients[layout.b1()]);

    resize(&mut batch.feature_gradients, samples * PADDED_FEATURES);
    let (from, to) = (&batch.gradient1, &mut batch.feature_gradients);
    let shape = (samples, PADDED_FEATURES, width);
    add_product::<L, R, V>(shape, from, width, &weights.w1_transposed, to, Finish::Keep);
}

#[inline(always)]
fn fill_rows(out: &mut [f32], row: &[f32]) {
    for out in out.chunks_exact_mut(row.len()) {
        out.copy_from_slice(row);
    }
}

#[inline(always)]
fn add_rows(rows: &[f32], sum: &mut [f32]) {
    for row in rows.chunks_exact(sum.len()) {
        sum.iter_mut().zip(row).for_each(|(s, x)| *s += x);
    }
}

#[inline(always)]
fn through_relu(gradient: &mut [f32], activation: &[f32]) {
    for (g, a) in gradient.iter_mut().zip(activation) {
        *g = if *a > 0.0 { *g } else { 0.0 };
    }
}
