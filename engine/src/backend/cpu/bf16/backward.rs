//! Gradients of colours to those of features and parameters.

use std::arch::x86_64::{
    __m512, __m512i, _mm512_add_ps, _mm512_castsi512_ps, _mm512_castsi512_si256,
    _mm512_cvtepu16_epi32, _mm512_extracti64x4_epi64, _mm512_fmadd_ps, _mm512_loadu_si512,
    _mm512_permutex2var_epi16, _mm512_permutexvar_epi16, _mm512_set1_ps, _mm512_setzero_ps,
    _mm512_slli_epi32,
};

use super::tile::{
    Finish, LANES, ROWS, add_gradient, load, load_pairs, product, store, store_pairs, to_pairs,
    where_active,
};
use super::{Bf16Batch, Bf16Weights};
use crate::backend::cpu::mlp::{MlpBatch, PADDED_FEATURES};
use crate::field::lattice::FEATURES;
use crate::field::mlp::MLP_OUTPUTS;
use crate::field::view_encoding::VIEW_INPUTS;

/// Most registers of f32 in a row: width 128.
const MAX_REGISTERS: usize = 8;

#[target_feature(enable = "avx512f,avx512bw,avx512bf16,avx512dq")]
pub(super) fn backward(weights: &Bf16Weights, batch: &mut MlpBatch, own: &mut Bf16Batch) {
    let (layout, width) = (weights.layout, weights.layout.width);
    let samples = batch.sample_count();
    let rows = samples.next_multiple_of(ROWS);
    if batch.parameter_gradients.len() != layout.len() {
        batch.parameter_gradients.clear();
        batch.parameter_gradients.resize(layout.len(), 0.0);
    }
    // Through the logistic: c (1 - c).
    let pairs = batch.color_gradients.iter_mut().zip(&batch.colors);
    pairs.for_each(|(g, c)| *g *= c * (1.0 - c));
    let half = rows * width / 2;
    own.gradient1.resize(half.max(own.gradient1.len()), 0);
    own.gradient2.resize(half.max(own.gradient2.len()), 0);

    last_layer(weights, batch, own, samples);
    own.gradient2[samples * width / 2..half].fill(0);
    let gradients = &mut batch.parameter_gradients;
    add_row_sums(&own.gradient2[..half], width, &mut gradients[layout.b2()]);
    pair_samples(&own.hidden1[..half], width, &mut own.left);
    pair_samples(&own.gradient2[..half], width, &mut own.right);
    let w2 = &mut gradients[layout.w2()];
    add_gradient((width, width), (&own.left, width), &own.right, w2);

    let mut finish = Finish::Where(&own.hidden1, &mut own.gradient1);
    let (a, b) = (&own.gradient2, &weights.w2_transposed);
    product((rows, width, width / 2), a, b, None, &mut finish);
    first_layer(weights, batch, own, rows);
}

/// Gradients by the second hidden layer, W3 and b3.
#[target_feature(enable = "avx512f,avx512bw,avx512bf16,avx512dq")]
fn last_layer(weights: &Bf16Weights, batch: &mut MlpBatch, own: &mut Bf16Batch, samples: usize) {
    let width = weights.layout.width;
    let registers = width / LANES;
    let mut sums = [[_mm512_setzero_ps(); MAX_REGISTERS]; 3];
    let mut bias = [0.0f32; 3];
    let rows = own.hidden2.chunks_exact(width / 2);
    let rows = rows.zip(own.gradient2.chunks_exact_mut(width / 2));
    for ((hidden, out), g) in rows
        .zip(batch.color_gradients.chunks_exact(MLP_OUTPUTS))
        .take(samples)
    {
        let mut lanes = [_mm512_setzero_ps(); 3];
        for c in 0..3 {
            bias[c] += g[c];
            lanes[c] = _mm512_set1_ps(g[c]);
        }
        for at in (0..registers).step_by(2) {
            let pairs = load_pairs(&hidden[at / 2 * LANES..]);
            let (low, high) = to_f32(pairs);
            let mut back = [_mm512_setzero_ps(); 2];
            for c in 0..3 {
                sums[c][at] = _mm512_fmadd_ps(lanes[c], low, sums[c][at]);
                sums[c][at + 1] = _mm512_fmadd_ps(lanes[c], high, sums[c][at + 1]);
                let w = &weights.w3[c * width + at * LANES..][..2 * LANES];
                back[0] = _mm512_fmadd_ps(lanes[c], load(w), back[0]);
                back[1] = _mm512_fmadd_ps(lanes[c], load(&w[LANES..]), back[1]);
            }
            let back = where_active(to_pairs(back[0], back[1]), pairs);
            store_pairs(back, &mut out[at / 2 * LANES..]);
        }
    }
    let layout = weights.layout;
    let gradients = &mut batch.parameter_gradients;
    for (g, b) in gradients[layout.b3()].iter_mut().zip(bias) {
        *g += b;
    }
    for (c, sums) in sums.iter().enumerate() {
        for (v, sum) in sums[..registers].iter().enumerate() {
            let mut lanes = [0.0; LANES];
            store(*sum, &mut lanes);
            let out =
                gradients[layout.w3()][v * LANES * MLP_OUTPUTS..].chunks_exact_mut(MLP_OUTPUTS);
            out.zip(lanes).for_each(|(row, x)| row[c] += x);
        }
    }
}

/// Gradients by W1, b1 and the features, from `gradient1`.
#[target_feature(enable = "avx512f,avx512bw,avx512bf16,avx512dq")]
fn first_layer(weights: &Bf16Weights, batch: &mut MlpBatch, own: &mut Bf16Batch, rows: usize) {
    let (layout, width) = (weights.layout, weights.layout.width);
    let half = rows * width / 2;
    batch.features.resize(rows * PADDED_FEATURES, 0.0);
    pair_features(&batch.features, &mut own.left);
    pair_samples(&own.gradient1[..half], width, &mut own.right);
    let (w1, w1_views) = batch.parameter_gradients[layout.w1()].split_at_mut(FEATURES * width);
    let left = (own.left.as_slice(), PADDED_FEATURES);
    add_gradient((FEATURES, width), left, &own.right, w1);

    let mut start = 0;
    own.rays.fill(0.0);
    for (end, sum) in batch.ray_ends.iter().zip(own.rays.chunks_exact_mut(width)) {
        let end = *end as usize * width / 2;
        add_row_sums(&own.gradient1[start..end], width, sum);
        start = end;
    }
    let rays = batch
        .views
        .chunks_exact(VIEW_INPUTS)
        .zip(own.rays.chunks_exact(width));
    for (view, sum) in rays {
        for (x, out) in view.iter().zip(w1_views.chunks_exact_mut(width)) {
            let x = _mm512_set1_ps(*x);
            for at in (0..width).step_by(LANES) {
                let out = &mut out[at..at + LANES];
                store(_mm512_fmadd_ps(x, load(&sum[at..]), load(out)), out);
            }
        }
    }
    let b1 = &mut batch.parameter_gradients[layout.b1()];
    for sum in own.rays.chunks_exact(width) {
        b1.iter_mut().zip(sum).for_each(|(b, x)| *b += x);
    }

    batch.feature_gradients.resize(rows * PADDED_FEATURES, 0.0);
    let mut finish = Finish::Keep(&mut batch.feature_gradients);
    let (a, b) = (&own.gradient1, &weights.w1_transposed);
    product((rows, PADDED_FEATURES, width / 2), a, b, None, &mut finish);
    let samples = batch.colors.len() / MLP_OUTPUTS;
    batch.features.truncate(samples * PADDED_FEATURES);
}

/// 16 pairs to 32 f32, in order.
#[inline]
#[target_feature(enable = "avx512f")]
fn to_f32(pairs: __m512i) -> (__m512, __m512) {
    let low = _mm512_cvtepu16_epi32(_mm512_castsi512_si256(pairs));
    let high = _mm512_cvtepu16_epi32(_mm512_extracti64x4_epi64::<1>(pairs));
    (
        _mm512_castsi512_ps(_mm512_slli_epi32::<16>(low)),
        _mm512_castsi512_ps(_mm512_slli_epi32::<16>(high)),
    )
}

/// Adds the rows of pairs to `sum`.
#[inline]
#[target_feature(enable = "avx512f,avx512bw")]
fn add_row_sums(rows: &[u32], width: usize, sum: &mut [f32]) {
    for at in (0..width).step_by(2 * LANES) {
        let mut sums = (load(&sum[at..]), load(&sum[at + LANES..]));
        for row in rows.chunks_exact(width / 2) {
            let (low, high) = to_f32(load_pairs(&row[at / 2..]));
            sums = (_mm512_add_ps(sums.0, low), _mm512_add_ps(sums.1, high));
        }
        store(sums.0, &mut sum[at..]);
        store(sums.1, &mut sum[at + LANES..]);
    }
}

/// Rows 2r and 2r + 1 of pairs of columns to one row of pairs of rows.
#[inline]
#[target_feature(enable = "avx512f,avx512bw")]
fn pair_samples(rows: &[u32], width: usize, out: &mut Vec<u32>) {
    const FIRST: [u16; 32] = interleaved(0, 32);
    const SECOND: [u16; 32] = interleaved(16, 48);
    let (first, second) = (indices(&FIRST), indices(&SECOND));
    out.resize(rows.len(), 0);
    for (rows, out) in rows.chunks_exact(width).zip(out.chunks_exact_mut(width)) {
        let (even, odd) = rows.split_at(width / 2);
        for at in (0..width / 2).step_by(LANES) {
            let (even, odd) = (load_pairs(&even[at..]), load_pairs(&odd[at..]));
            let out = &mut out[2 * at..2 * at + 2 * LANES];
            store_pairs(_mm512_permutex2var_epi16(even, first, odd), out);
            store_pairs(
                _mm512_permutex2var_epi16(even, second, odd),
                &mut out[LANES..],
            );
        }
    }
}

/// Rows 2r and 2r + 1 of 16 features to one row of pairs of rows.
#[inline]
#[target_feature(enable = "avx512f,avx512bw,avx512bf16")]
fn pair_features(rows: &[f32], out: &mut Vec<u32>) {
    const ORDER: [u16; 32] = interleaved(0, 16);
    let order = indices(&ORDER);
    out.resize(rows.len() / 2, 0);
    let rows = rows.chunks_exact(2 * PADDED_FEATURES);
    for (rows, out) in rows.zip(out.chunks_exact_mut(PADDED_FEATURES)) {
        let pairs = to_pairs(load(rows), load(&rows[PADDED_FEATURES..]));
        store_pairs(_mm512_permutexvar_epi16(order, pairs), out);
    }
}

/// Position `even + i` for half 2i and `odd + i` for half 2i + 1.
const fn interleaved(even: u16, odd: u16) -> [u16; 32] {
    let mut out = [0; 32];
    let mut i = 0;
    while i < 16 {
        out[2 * i] = even + i as u16;
        out[2 * i + 1] = odd + i as u16;
        i += 1;
    }
    out
}

#[inline]
#[target_feature(enable = "avx512f")]
fn indices(of: &[u16; 32]) -> __m512i {
    // SAFETY: 32 u16 are a register.
    unsafe { _mm512_loadu_si512(of.as_ptr().cast()) }
}
