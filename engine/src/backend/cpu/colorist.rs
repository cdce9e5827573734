//! The colour network in the form that this machine computes fastest.

use super::bf16::{Bf16, Bf16Batch, Bf16Weights};
use super::mlp::{MlpBatch, TransposedWeights};
use super::simd::Simd;
use crate::field::ColorMlp;

/// Copies of a network's weights as its kernels read them.
#[derive(Clone, Debug)]
pub(crate) enum Colorist {
    F32(ColorMlp, TransposedWeights, Simd),
    Bf16(Bf16, Bf16Weights),
}

impl Colorist {
    /// In bfloat16 where the machine multiplies that, else in f32.
    pub(crate) fn fastest(mlp: &ColorMlp) -> Self {
        match Bf16::detect() {
            Some(bf16) if Bf16Weights::WIDTHS.contains(&mlp.width()) => {
                Self::Bf16(bf16, Bf16Weights::new(mlp))
            }
            _ => Self::exact(mlp, Simd::detect()),
        }
    }

    /// In f32.
    pub(crate) fn exact(mlp: &ColorMlp, simd: Simd) -> Self {
        Self::F32(mlp.clone(), TransposedWeights::new(mlp), simd)
    }

    /// Takes over changed parameters.
    pub(crate) fn update(&mut self, mlp: &ColorMlp) {
        match self {
            Self::F32(own, transposed, _) => {
                own.clone_from(mlp);
                transposed.update(mlp);
            }
            Self::Bf16(_, weights) => weights.update(mlp),
        }
    }

    /// Computes the colours of a batch whose features and views are set.
    pub(crate) fn forward(&self, batch: &mut MlpBatch, own: &mut Bf16Batch) {
        match self {
            Self::F32(mlp, _, simd) => batch.forward(mlp, *simd),
            Self::Bf16(bf16, weights) => bf16.forward(weights, batch, own),
        }
    }

    /// From the colours' gradients, computes the features' and adds to the parameters', after [`Self::forward`].
    pub(crate) fn backward(&self, batch: &mut MlpBatch, own: &mut Bf16Batch) {
        match self {
            Self::F32(_, transposed, simd) => batch.backward(transposed, *simd),
            Self::Bf16(bf16, weights) => bf16.backward(weights, batch, own),
        }
    }
}
