//! Optimisers of the small dense parameters: the colour network and the sky.

use super::chunk::Chunk;
use crate::field::SkyMap;

/// DVGO's decay rates.
pub(crate) const BETA1: f32 = 0.9;
pub(crate) const BETA2: f32 = 0.99;
pub(crate) const EPSILON: f32 = 1e-8;

/// Adam over one parameter array.
#[derive(Clone, Debug, Default)]
pub(crate) struct Adam {
    mean: Vec<f32>,
    square: Vec<f32>,
    steps: i32,
}

impl Adam {
    pub(crate) fn step(&mut self, parameters: &mut [f32], gradients: &[f32], rate: f32) {
        self.mean.resize(parameters.len(), 0.0);
        self.square.resize(parameters.len(), 0.0);
        self.steps += 1;
        let correction1 = 1.0 - BETA1.powi(self.steps);
        let correction2 = 1.0 - BETA2.powi(self.steps);
        let rate = rate * correction2.sqrt() / correction1;
        let state = self.mean.iter_mut().zip(&mut self.square);
        for ((p, g), (m, v)) in parameters.iter_mut().zip(gradients).zip(state) {
            *m += (1.0 - BETA1) * (g - *m);
            *v += (1.0 - BETA2) * (g * g - *v);
            *p -= rate * *m / (v.sqrt() + EPSILON);
        }
    }
}

/// Sums and applies the sky gradients, texel by texel, only where there are any.
#[derive(Clone, Debug, Default)]
pub(super) struct SkyOptimizer {
    gradients: Vec<Vec<[f32; 3]>>,
    squares: Vec<Vec<f32>>,
    touched: Vec<(u32, u32)>,
}

/// Decay of the squared gradients' running mean.
pub(in crate::backend) const SKY_DECAY: f32 = 0.95;

impl SkyOptimizer {
    pub(super) fn step(&mut self, sky: &mut SkyMap, chunks: &[Chunk], rate: f32) {
        self.gradients.resize_with(sky.grids().len(), Vec::new);
        self.squares.resize_with(sky.grids().len(), Vec::new);
        for (number, grid) in sky.grids().iter().enumerate() {
            self.gradients[number].resize(grid.logits().len(), [0.0; 3]);
            self.squares[number].resize(grid.logits().len(), 0.0);
        }
        for point in chunks.iter().flat_map(|chunk| &chunk.sky) {
            let sum = &mut self.gradients[point.grid as usize][point.texel as usize];
            if *sum == [0.0; 3] {
                self.touched.push((point.grid, point.texel));
            }
            (0..3).for_each(|c| sum[c] += point.logits[c]);
        }
        for (grid, texel) in self.touched.drain(..) {
            let (grid, texel) = (grid as usize, texel as usize);
            // A texel may be listed twice if its sum passed through 0; the second time there is nothing left.
            let gradient = std::mem::take(&mut self.gradients[grid][texel]);
            let square = gradient.iter().map(|g| g * g).sum::<f32>() / 3.0;
            if square > 0.0 {
                let mean = &mut self.squares[grid][texel];
                *mean = if *mean == 0.0 {
                    square
                } else {
                    SKY_DECAY * *mean + (1.0 - SKY_DECAY) * square
                };
                let rate = rate / mean.sqrt();
                let logits = &mut sky.grids_mut()[grid].logits_mut()[texel];
                (0..3).for_each(|c| logits[c] -= rate * gradient[c]);
            }
        }
    }
}
