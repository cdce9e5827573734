//! The colour network's first weights.

use crate::field::ColorMlp;
use crate::field::mlp::{MLP_INPUTS, MLP_OUTPUTS, MlpLayout};

/// A network as the recipe starts it: weights and biases uniform within +-1/sqrt(inputs of the layer), the last bias 0.
///
/// `unit` draws from 0..1.
pub(super) fn initial_network(width: usize, mut unit: impl FnMut() -> f64) -> ColorMlp {
    let layout = MlpLayout { width };
    let mut parameters = vec![0.0f32; layout.len()];
    let mut draw = |values: &mut [f32], inputs: usize| {
        let bound = 1.0 / (inputs as f64).sqrt();
        values
            .iter_mut()
            .for_each(|v| *v = ((2.0 * unit() - 1.0) * bound) as f32);
    };
    draw(&mut parameters[layout.w1()], MLP_INPUTS);
    draw(&mut parameters[layout.b1()], MLP_INPUTS);
    draw(&mut parameters[layout.w2()], width);
    draw(&mut parameters[layout.b2()], width);
    for row in parameters[layout.w3()].chunks_exact_mut(MLP_OUTPUTS) {
        draw(&mut row[..3], width);
    }
    ColorMlp::from_parameters(width, parameters).expect("the recipe's width has a kernel")
}
