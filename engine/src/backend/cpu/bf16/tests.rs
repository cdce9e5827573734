//! The f32 path is the oracle.

use super::*;
use crate::backend::cpu::Simd;
use crate::backend::cpu::mlp::{PADDED_FEATURES, TransposedWeights};
use crate::scene::Draws;

fn batch(draws: &mut Draws, per_ray: &[usize]) -> MlpBatch {
    let mut batch = MlpBatch::default();
    let mut uniform = |count: usize| -> Vec<f32> {
        (0..count)
            .map(|_| draws.uniform(-1.0, 1.0) as f32)
            .collect()
    };
    let mut end = 0;
    for samples in per_ray {
        for _ in 0..*samples {
            batch.features.extend(uniform(12));
            batch.features.extend([0.0; PADDED_FEATURES - 12]);
        }
        batch.views.extend(uniform(27));
        end += *samples as u32;
        batch.ray_ends.push(end);
    }
    batch.color_gradients = uniform(4 * end as usize);
    // The fourth channel is padding.
    batch
        .color_gradients
        .chunks_exact_mut(4)
        .for_each(|g| g[3] = 0.0);
    batch
}

/// ||a - b|| / ||b||.
fn error(a: &[f32], b: &[f32]) -> f32 {
    assert_eq!(a.len(), b.len());
    let square = |x: f32| f64::from(x) * f64::from(x);
    let off: f64 = a.iter().zip(b).map(|(a, b)| square(a - b)).sum();
    (off / b.iter().map(|b| square(*b)).sum::<f64>()).sqrt() as f32
}

/// Errors of colours, feature gradients and each layer's parameter gradients; `given` computes the rounded path.
fn errors(width: usize, given: impl Fn(&ColorMlp) -> ColorMlp) -> Option<Vec<f32>> {
    let bf16 = Bf16::detect()?;
    let mut draws = Draws::new(5, 0, 0);
    let mlp = ColorMlp::new(width, || draws.unit());
    let mut exact = batch(&mut draws, &[3, 1, 9, 20, 7]);
    let mut rounded = exact.clone();
    exact.forward(&mlp, Simd::Baseline);
    exact.backward(&TransposedWeights::new(&mlp), Simd::Baseline);
    let (weights, mut own) = (Bf16Weights::new(&given(&mlp)), Bf16Batch::default());
    // Twice, the second time in buffers that hold other values.
    for _ in 0..2 {
        let mut again = rounded.clone();
        bf16.forward(&weights, &mut again, &mut own);
        bf16.backward(&weights, &mut again, &mut own);
        if rounded.parameter_gradients.is_empty() {
            own.hidden1.iter_mut().for_each(|x| *x = 0x4040_4040);
            rounded.parameter_gradients = vec![0.0; mlp.parameters().len()];
        } else {
            rounded = again;
        }
    }
    let colors = |batch: &MlpBatch| -> Vec<f32> {
        let rows = batch.colors.chunks_exact(4);
        rows.flat_map(|c| [c[0], c[1], c[2]]).collect()
    };
    let samples = exact.sample_count() * PADDED_FEATURES;
    let mut errors = vec![
        error(&colors(&rounded), &colors(&exact)),
        error(
            &rounded.feature_gradients[..samples],
            &exact.feature_gradients[..samples],
        ),
    ];
    let layout = mlp.layout();
    let ranges = [
        layout.w1(),
        layout.b1(),
        layout.w2(),
        layout.b2(),
        layout.w3(),
        layout.b3(),
    ];
    errors.extend(ranges.map(|range| {
        error(
            &rounded.parameter_gradients[range.clone()],
            &exact.parameter_gradients[range],
        )
    }));
    Some(errors)
}

/// 8 bits of mantissa are 0.4 % a value, twice per layer, and rounding switches some units: up to 3 % were seen.
const TOLERANCE: f32 = 0.04;

#[test]
fn bf16_agrees_with_f32() {
    for width in Bf16Weights::WIDTHS {
        let Some(errors) = errors(width, ColorMlp::clone) else {
            eprintln!("skipped: this machine has no bfloat16 dot product");
            return;
        };
        assert!(errors.iter().all(|e| *e < TOLERANCE), "{width}: {errors:?}");
    }
}

#[test]
fn one_wrong_weight_is_noticed() {
    let spoilt = |mlp: &ColorMlp| {
        let (width, mut p) = (mlp.width(), mlp.parameters().to_vec());
        p[mlp.layout().w2()]
            .iter_mut()
            .step_by(7)
            .for_each(|w| *w *= -1.0);
        ColorMlp::from_parameters(width, p).unwrap()
    };
    if let Some(errors) = errors(64, spoilt) {
        assert!(errors.iter().any(|e| *e > TOLERANCE), "{errors:?}");
    }
}
