//! Features and views to colours.

use std::arch::x86_64::{_mm512_fmadd_ps, _mm512_reduce_add_ps, _mm512_set1_ps, _mm512_setzero_ps};

use super::tile::{Finish, LANES, ROWS, dot, load, load_pairs, product, put};
use super::{Bf16Batch, Bf16Weights};
use crate::backend::cpu::mlp::{MlpBatch, PADDED_FEATURES};
use crate::field::activation::sigmoid;
use crate::field::lattice::FEATURES;
use crate::field::mlp::MLP_OUTPUTS;
use crate::field::view_encoding::VIEW_INPUTS;

#[target_feature(enable = "avx512f,avx512bw,avx512bf16")]
pub(super) fn forward(weights: &Bf16Weights, batch: &mut MlpBatch, own: &mut Bf16Batch) {
    let width = weights.layout.width;
    let samples = batch.sample_count();
    let rows = samples.next_multiple_of(ROWS);
    own.ray_of.clear();
    let mut start = 0;
    for (ray, end) in batch.ray_ends.iter().enumerate() {
        own.ray_of.extend((start..*end).map(|_| ray as u32));
        start = *end;
    }
    // Padding rows need a ray, too; what they yield is never read.
    own.ray_of.resize(rows, 0);
    batch.features.resize(rows * PADDED_FEATURES, 0.0);
    view_share(weights, batch, own);
    let half = rows * width / 2;
    own.hidden1.resize(half.max(own.hidden1.len()), 0);
    own.hidden2.resize(half.max(own.hidden2.len()), 0);
    if rows > 0 {
        first_layer(weights, batch, own, rows);
    }
    let mut finish = Finish::Relu(&mut own.hidden2);
    let (a, b) = (&own.hidden1, &weights.w2);
    product(
        (rows, width, width / 2),
        a,
        b,
        Some(&weights.b2),
        &mut finish,
    );
    last_layer(weights, batch, own, samples);
    batch.features.truncate(samples * PADDED_FEATURES);
}

/// What the views and the bias add to the first layer, once per ray and in f32.
#[target_feature(enable = "avx512f,avx512bw,avx512bf16")]
fn view_share(weights: &Bf16Weights, batch: &MlpBatch, own: &mut Bf16Batch) {
    let width = weights.layout.width;
    own.rays.resize(batch.ray_ends.len() * width, 0.0);
    let rays = batch.views.chunks_exact(VIEW_INPUTS);
    for (view, out) in rays.zip(own.rays.chunks_exact_mut(width)) {
        for column in (0..width).step_by(2 * LANES) {
            let mut sums = [
                load(&weights.b1[column..]),
                load(&weights.b1[column + LANES..]),
            ];
            for (x, row) in view.iter().zip(weights.w1_views.chunks_exact(width)) {
                let x = _mm512_set1_ps(*x);
                for (v, sum) in sums.iter_mut().enumerate() {
                    *sum = _mm512_fmadd_ps(x, load(&row[column + v * LANES..]), *sum);
                }
            }
            for (v, sum) in sums.into_iter().enumerate() {
                super::tile::store(sum, &mut out[column + v * LANES..]);
            }
        }
    }
}

/// f32 inputs, so that features keep their precision.
#[target_feature(enable = "avx512f,avx512bw,avx512bf16")]
fn first_layer(weights: &Bf16Weights, batch: &MlpBatch, own: &mut Bf16Batch, rows: usize) {
    let width = weights.layout.width;
    let mut finish = Finish::Relu(&mut own.hidden1);
    for row in (0..rows).step_by(ROWS) {
        let features = &batch.features[row * PADDED_FEATURES..][..ROWS * PADDED_FEATURES];
        let rays = &own.ray_of[row..row + ROWS];
        for column in (0..width).step_by(2 * LANES) {
            let mut sums = [[_mm512_setzero_ps(); 2]; ROWS];
            for (sums, ray) in sums.iter_mut().zip(rays) {
                let start = &own.rays[*ray as usize * width + column..][..2 * LANES];
                (sums[0], sums[1]) = (load(start), load(&start[LANES..]));
            }
            for f in 0..FEATURES {
                let w = &weights.w1[f * width + column..][..2 * LANES];
                let (w0, w1) = (load(w), load(&w[LANES..]));
                for (r, sums) in sums.iter_mut().enumerate() {
                    let x = _mm512_set1_ps(features[r * PADDED_FEATURES + f]);
                    sums[0] = _mm512_fmadd_ps(x, w0, sums[0]);
                    sums[1] = _mm512_fmadd_ps(x, w1, sums[1]);
                }
            }
            for (r, sums) in sums.iter().enumerate() {
                put::<2>((row + r) * width + column, sums, &mut finish);
            }
        }
    }
}

#[target_feature(enable = "avx512f,avx512bw,avx512bf16")]
fn last_layer(weights: &Bf16Weights, batch: &mut MlpBatch, own: &Bf16Batch, samples: usize) {
    let half = weights.layout.width / 2;
    batch.colors.resize(samples * MLP_OUTPUTS, 0.0);
    let rows = own.hidden2.chunks_exact(half);
    for (row, out) in rows.zip(batch.colors.chunks_exact_mut(MLP_OUTPUTS)) {
        for (c, w) in weights.w3_pairs.chunks_exact(half).enumerate() {
            let mut sum = _mm512_setzero_ps();
            for at in (0..half).step_by(LANES) {
                sum = dot(sum, load_pairs(&row[at..]), load_pairs(&w[at..]));
            }
            out[c] = _mm512_reduce_add_ps(sum) + weights.b3[c];
        }
    }
    for x in &mut batch.colors {
        *x = sigmoid(*x);
    }
}
