//! The colour network in bfloat16 with sums in f32, on AVX-512 machines that have its dot product.
//!
//! One instruction multiplies 32 pairs where the f32 path multiplies 16, and activations take half the cache. Master weights,
//! optimiser and the sums of gradients stay f32; rounding weights and activations to 8 bits of mantissa changes a colour by
//! about 1e-3, a tenth of what a trained field is off by. Values are held as u32 with the even neighbour in the lower half.

#[cfg(target_arch = "x86_64")]
mod backward;
#[cfg(target_arch = "x86_64")]
mod forward;
mod pack;
#[cfg(target_arch = "x86_64")]
mod tile;

use crate::field::ColorMlp;
use crate::field::mlp::MlpLayout;

use super::mlp::MlpBatch;

/// Most columns of weights that lie together: with 64 pairs of inputs 16 KiB, half of the first-level cache.
const PANEL: usize = 64;

/// Proof that this machine has the instructions.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Bf16(());

/// Packed copies of the weights.
#[derive(Clone, Debug)]
pub(crate) struct Bf16Weights {
    layout: MlpLayout,
    /// f32, straight from the network: features' rows of W1, all biases and W3's columns.
    w1: Vec<f32>,
    w1_views: Vec<f32>,
    b1: Vec<f32>,
    b2: Vec<f32>,
    b3: [f32; 3],
    /// `[3][width]`.
    w3: Vec<f32>,
    /// `[width / PANEL][width / 2][PANEL]`, pairs of inputs.
    w2: Vec<u32>,
    /// `[width / PANEL][width / 2][PANEL]`, pairs of outputs.
    w2_transposed: Vec<u32>,
    /// `[width / 2][16]`, pairs of outputs.
    w1_transposed: Vec<u32>,
    /// `[3][width / 2]`.
    w3_pairs: Vec<u32>,
}

/// Activations and gradients of a batch, rows padded to whole tiles.
#[derive(Clone, Debug, Default)]
pub(crate) struct Bf16Batch {
    /// Ray of every sample.
    ray_of: Vec<u32>,
    /// The views' share of the first layer, `[ray][width]`.
    rays: Vec<f32>,
    /// `[sample][width / 2]`.
    hidden1: Vec<u32>,
    hidden2: Vec<u32>,
    gradient1: Vec<u32>,
    gradient2: Vec<u32>,
    /// `[sample / 2][width]`, pairs of samples: the operands of weight gradients.
    left: Vec<u32>,
    right: Vec<u32>,
}

impl Bf16 {
    pub(crate) fn detect() -> Option<Self> {
        let whole = super::Simd::detect() == super::Simd::Avx512;
        (whole && has_dot_product()).then_some(Self(()))
    }

    /// Computes the colours of a batch whose features and views are set.
    pub(crate) fn forward(self, weights: &Bf16Weights, batch: &mut MlpBatch, own: &mut Bf16Batch) {
        // SAFETY: `self` proves that the machine has the instructions.
        #[cfg(target_arch = "x86_64")]
        unsafe {
            forward::forward(weights, batch, own);
        }
        #[cfg(not(target_arch = "x86_64"))]
        unreachable!("not detected: {weights:?} {batch:?} {own:?}");
    }

    /// From `color_gradients`, computes `feature_gradients` and adds to `parameter_gradients`, after [`Self::forward`].
    pub(crate) fn backward(self, weights: &Bf16Weights, batch: &mut MlpBatch, own: &mut Bf16Batch) {
        // SAFETY: as above.
        #[cfg(target_arch = "x86_64")]
        unsafe {
            backward::backward(weights, batch, own);
        }
        #[cfg(not(target_arch = "x86_64"))]
        unreachable!("not detected: {weights:?} {batch:?} {own:?}");
    }
}

#[cfg(target_arch = "x86_64")]
fn has_dot_product() -> bool {
    is_x86_feature_detected!("avx512bf16")
}

#[cfg(not(target_arch = "x86_64"))]
fn has_dot_product() -> bool {
    false
}

impl Bf16Weights {
    /// Hidden widths that fill whole registers of pairs.
    pub(crate) const WIDTHS: [usize; 3] = [32, 64, 128];

    pub(crate) fn new(mlp: &ColorMlp) -> Self {
        assert!(Self::WIDTHS.contains(&mlp.width()), "width has no kernel");
        let mut weights = Self {
            layout: mlp.layout(),
            w1: Vec::new(),
            w1_views: Vec::new(),
            b1: Vec::new(),
            b2: Vec::new(),
            b3: [0.0; 3],
            w3: Vec::new(),
            w2: Vec::new(),
            w2_transposed: Vec::new(),
            w1_transposed: Vec::new(),
            w3_pairs: Vec::new(),
        };
        weights.update(mlp);
        weights
    }

    /// Packs changed parameters.
    pub(crate) fn update(&mut self, mlp: &ColorMlp) {
        pack::update(self, mlp);
    }
}

#[cfg(test)]
mod tests;
