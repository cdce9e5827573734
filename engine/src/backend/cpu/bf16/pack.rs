//! Weights rearranged for the dot product: two neighbours of the summed index in one u32.

use super::{Bf16Weights, PANEL};
use crate::backend::cpu::mlp::PADDED_FEATURES;
use crate::field::ColorMlp;
use crate::field::lattice::FEATURES;
use crate::field::mlp::MLP_OUTPUTS;

pub(super) fn update(packed: &mut Bf16Weights, mlp: &ColorMlp) {
    let (width, layout, p) = (mlp.width(), mlp.layout(), mlp.parameters());
    let (w1, views) = p[layout.w1()].split_at(FEATURES * width);
    let (w2, w3) = (&p[layout.w2()], &p[layout.w3()]);
    packed.w1.clear();
    packed.w1.extend_from_slice(w1);
    packed.w1_views.clear();
    packed.w1_views.extend_from_slice(views);
    packed.b1.clear();
    packed.b1.extend_from_slice(&p[layout.b1()]);
    packed.b2.clear();
    packed.b2.extend_from_slice(&p[layout.b2()]);
    packed.b3.copy_from_slice(&p[layout.b3()][..3]);
    packed.w3.clear();
    for c in 0..3 {
        packed.w3.extend(w3.iter().skip(c).step_by(MLP_OUTPUTS));
    }
    fill_pairs(&mut packed.w2, (width, width), |k, j| w2[k * width + j]);
    fill_pairs(&mut packed.w2_transposed, (width, width), |j, k| {
        w2[k * width + j]
    });
    fill_pairs(
        &mut packed.w1_transposed,
        (width, PADDED_FEATURES),
        |j, f| {
            if f < FEATURES { w1[f * width + j] } else { 0.0 }
        },
    );
    let pairs = packed.w3.chunks_exact(2).map(|c| pair(c[0], c[1]));
    packed.w3_pairs.clear();
    packed.w3_pairs.extend(pairs);
}

/// Writes `value(row, column)` with rows 2r and 2r + 1 paired, in panels of columns as [`super::tile::product`] reads them.
fn fill_pairs(
    out: &mut Vec<u32>,
    (rows, columns): (usize, usize),
    value: impl Fn(usize, usize) -> f32,
) {
    let panel = columns.min(PANEL);
    out.clear();
    for first in (0..columns).step_by(panel) {
        for row in (0..rows).step_by(2) {
            let columns = first..first + panel;
            out.extend(columns.map(|column| pair(value(row, column), value(row + 1, column))));
        }
    }
}

fn pair(low: f32, high: f32) -> u32 {
    u32::from(round(low)) | u32::from(round(high)) << 16
}

/// To the nearest bfloat16, ties to even. Weights are finite: training stops before they are not.
pub(super) fn round(x: f32) -> u16 {
    let bits = x.to_bits();
    ((bits + 0x7fff + (bits >> 16 & 1)) >> 16) as u16
}
