//! The colour network: interpolated features and the encoded view direction to sRGB.

use std::fmt;

use super::activation::sigmoid;
use super::lattice::FEATURES;
use super::view_encoding::VIEW_INPUTS;

/// 12 features and 27 view inputs.
pub const MLP_INPUTS: usize = FEATURES + VIEW_INPUTS;
/// Colour channels, padded to one vector of four; the fourth is unused and stays 0.
pub const MLP_OUTPUTS: usize = 4;

/// `rgb = sigmoid(W3 relu(W2 relu(W1 [features, view] + b1) + b2) + b3)`, weights stored input-major (`[input][output]`).
#[derive(Clone, PartialEq)]
pub struct ColorMlp {
    width: usize,
    parameters: Vec<f32>,
}

/// Where each layer's values lie in [`ColorMlp::parameters`].
#[derive(Clone, Copy, Debug)]
pub struct MlpLayout {
    pub width: usize,
}

impl MlpLayout {
    pub fn w1(&self) -> std::ops::Range<usize> {
        0..MLP_INPUTS * self.width
    }

    pub fn b1(&self) -> std::ops::Range<usize> {
        after(self.w1(), self.width)
    }

    pub fn w2(&self) -> std::ops::Range<usize> {
        after(self.b1(), self.width * self.width)
    }

    pub fn b2(&self) -> std::ops::Range<usize> {
        after(self.w2(), self.width)
    }

    pub fn w3(&self) -> std::ops::Range<usize> {
        after(self.b2(), self.width * MLP_OUTPUTS)
    }

    pub fn b3(&self) -> std::ops::Range<usize> {
        after(self.w3(), MLP_OUTPUTS)
    }

    pub fn len(&self) -> usize {
        self.b3().end
    }

    pub fn is_empty(&self) -> bool {
        false
    }
}

fn after(previous: std::ops::Range<usize>, len: usize) -> std::ops::Range<usize> {
    previous.end..previous.end + len
}

impl ColorMlp {
    /// Hidden widths the vectorised kernels serve.
    pub const WIDTHS: [usize; 4] = [16, 32, 64, 128];

    /// A network whose weights are drawn by `unit` (uniform in 0..1) within Kaiming's bounds; biases are 0.
    ///
    /// # Panics
    /// If `width` is not one of [`Self::WIDTHS`].
    pub fn new(width: usize, mut unit: impl FnMut() -> f64) -> Self {
        assert!(Self::WIDTHS.contains(&width), "width {width} has no kernel");
        let layout = MlpLayout { width };
        let mut parameters = vec![0.0; layout.len()];
        // Kaiming uniform for ReLU: +-sqrt(6 / fan_in); half of it before the logistic, so that colours start near grey.
        let layers = [
            (layout.w1(), MLP_INPUTS, width, 1.0),
            (layout.w2(), width, width, 1.0),
            (layout.w3(), width, 3, 0.5),
        ];
        for (range, fan_in, used, gain) in layers {
            let bound = gain * (6.0 / fan_in as f64).sqrt();
            let row = range.len() / fan_in;
            for weights in parameters[range].chunks_mut(row) {
                for weight in &mut weights[..used] {
                    *weight = ((2.0 * unit() - 1.0) * bound) as f32;
                }
            }
        }
        Self { width, parameters }
    }

    /// A network from stored parameters; `None` if their count does not fit the width.
    pub fn from_parameters(width: usize, parameters: Vec<f32>) -> Option<Self> {
        let fits = Self::WIDTHS.contains(&width) && parameters.len() == MlpLayout { width }.len();
        fits.then_some(Self { width, parameters })
    }

    pub fn width(&self) -> usize {
        self.width
    }

    pub fn layout(&self) -> MlpLayout {
        MlpLayout { width: self.width }
    }

    pub fn parameters(&self) -> &[f32] {
        &self.parameters
    }

    pub fn parameters_mut(&mut self) -> &mut [f32] {
        &mut self.parameters
    }

    /// One colour, in plain loops: what the vectorised kernels are checked against.
    pub fn forward(&self, features: &[f32; FEATURES], view: &[f32; VIEW_INPUTS]) -> [f32; 3] {
        let layout = self.layout();
        let p = &self.parameters;
        let mut input = [0.0; MLP_INPUTS];
        input[..FEATURES].copy_from_slice(features);
        input[FEATURES..].copy_from_slice(view);
        let relu = |mut layer: Vec<f32>| {
            layer.iter_mut().for_each(|x| *x = x.max(0.0));
            layer
        };
        let hidden = relu(affine(&p[layout.w1()], &p[layout.b1()], &input));
        let hidden = relu(affine(&p[layout.w2()], &p[layout.b2()], &hidden));
        let out = affine(&p[layout.w3()], &p[layout.b3()], &hidden);
        [sigmoid(out[0]), sigmoid(out[1]), sigmoid(out[2])]
    }
}

fn affine(weights: &[f32], bias: &[f32], input: &[f32]) -> Vec<f32> {
    let mut out = bias.to_vec();
    for (row, x) in weights.chunks_exact(bias.len()).zip(input) {
        for (sum, weight) in out.iter_mut().zip(row) {
            *sum += weight * x;
        }
    }
    out
}

/// Width only.
impl fmt::Debug for ColorMlp {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("ColorMlp")
            .field("width", &self.width)
            .finish_non_exhaustive()
    }
}
