//! Kernels by themselves, for the benchmarks only.

use super::bf16::Bf16Batch;
use super::colorist::Colorist;
use super::mlp::{MlpBatch, PADDED_FEATURES};
use super::simd::Simd;
use crate::field::mlp::MLP_OUTPUTS;
use crate::field::view_encoding::VIEW_INPUTS;
use crate::field::{ColorMlp, FEATURES};
use crate::scene::Draws;

pub use crate::train::dvgo::GridKernels;

/// A colour network with a batch of samples.
#[derive(Debug)]
pub struct NetworkKernels {
    colorist: Colorist,
    batch: MlpBatch,
    bf16: Bf16Batch,
}

impl NetworkKernels {
    /// `rays` rays of `per_ray` samples; in f32 if `exact`, else in the machine's fastest form.
    pub fn new(width: usize, (rays, per_ray): (usize, usize), exact: bool) -> Self {
        let mut draws = Draws::new(1, 0, 0);
        let mlp = ColorMlp::new(width, || draws.unit());
        let mut batch = MlpBatch::default();
        let mut uniform = || draws.uniform(-1.0, 1.0) as f32;
        for ray in 0..rays {
            for _ in 0..per_ray {
                let row: [f32; FEATURES] = std::array::from_fn(|_| uniform());
                batch.features.extend(row);
                batch.features.extend([0.0; PADDED_FEATURES - FEATURES]);
            }
            batch.views.extend((0..VIEW_INPUTS).map(|_| uniform()));
            batch.ray_ends.push(((ray + 1) * per_ray) as u32);
        }
        let colorist = if exact {
            Colorist::exact(&mlp, Simd::detect())
        } else {
            Colorist::fastest(&mlp)
        };
        Self {
            colorist,
            batch,
            bf16: Bf16Batch::default(),
        }
    }

    pub fn sample_count(&self) -> usize {
        self.batch.sample_count()
    }

    pub fn forward(&mut self) {
        self.colorist.forward(&mut self.batch, &mut self.bf16);
    }

    /// Needs one [`Self::forward`] before.
    pub fn backward(&mut self) {
        let values = self.batch.sample_count() * MLP_OUTPUTS;
        self.batch.color_gradients.clear();
        self.batch.color_gradients.resize(values, 0.01);
        self.colorist.backward(&mut self.batch, &mut self.bf16);
    }
}
