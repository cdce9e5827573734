//! Every gradient against f64 central differences, and every check against a formula broken on purpose.

use super::*;
use crate::field::RaySample;
use crate::scene::Draws;

/// Largest relative error between f32 gradients and f64 differences: rounding of 16 samples' sums stays near 1e-5.
const TOLERANCE: f64 = 1e-3;
/// Step of the central differences: truncation h^2 and rounding 1e-16 / h both stay below 1e-9.
const H: f64 = 1e-5;

/// Largest difference relative to the largest gradient.
fn relative_error(analytic: &[f64], numeric: &[f64]) -> f64 {
    let scale = numeric.iter().fold(1e-12, |m: f64, x| m.max(x.abs()));
    let pairs = analytic.iter().zip(numeric);
    pairs.fold(0.0, |m: f64, (a, n)| m.max((a - n).abs())) / scale
}

fn differences(x: &[f64], loss: &dyn Fn(&[f64]) -> f64) -> Vec<f64> {
    let at = |i: usize, h: f64| {
        let mut x = x.to_vec();
        x[i] += h;
        loss(&x)
    };
    (0..x.len())
        .map(|i| (at(i, H) - at(i, -H)) / (2.0 * H))
        .collect()
}

/// Accepts the right gradient and rejects the broken one.
fn check(x: &[f64], loss: &dyn Fn(&[f64]) -> f64, right: &[f64], broken: &[f64]) {
    let numeric = differences(x, loss);
    let error = relative_error(right, &numeric);
    assert!(error < TOLERANCE, "relative error {error}");
    let error = relative_error(broken, &numeric);
    assert!(
        error > 10.0 * TOLERANCE,
        "a broken gradient passes with {error}"
    );
}

fn check_scalar(x: f64, loss: &dyn Fn(f64) -> f64, right: Loss, broken: f32) {
    let value = loss(x);
    assert!((f64::from(right.value) - value).abs() < TOLERANCE * value.abs().max(1.0));
    let loss = |x: &[f64]| loss(x[0]);
    check(
        &[x],
        &loss,
        &[f64::from(right.gradient)],
        &[f64::from(broken)],
    );
}

/// Weights and remainder of optical depths, straight from the definition.
fn definition(taus: &[f64]) -> (Vec<f64>, f64) {
    let mut transmittance = 1.0;
    let weights = taus.iter().map(|tau| {
        let weight = transmittance * (1.0 - (-tau).exp());
        transmittance *= (-tau).exp();
        weight
    });
    (weights.collect(), (-taus.iter().sum::<f64>()).exp())
}

struct Case {
    samples: Vec<RaySample>,
    taus: Vec<f64>,
    /// Any linear loss in weights and remainder: its coefficients.
    by_weight: Vec<f32>,
    by_end: f32,
}

fn case(seed: u64) -> Case {
    let mut draws = Draws::new(seed, 0, 0);
    let samples: Vec<RaySample> = (0..16)
        .map(|i| RaySample {
            t: 1.0 + 0.1 * i as f32,
            dt: 0.1,
            sigma: draws.uniform(0.0, 4.0) as f32,
        })
        .collect();
    Case {
        taus: samples
            .iter()
            .map(|s| f64::from(s.sigma) * f64::from(s.dt))
            .collect(),
        by_weight: samples.iter().map(|_| draws.jitter(2.0) as f32).collect(),
        by_end: draws.jitter(2.0) as f32,
        samples,
    }
}

#[test]
fn weights_follow_the_definition_and_sum_to_one_with_the_remainder() {
    for seed in 0..8 {
        let case = case(seed);
        let mut w = vec![0.0; 16];
        let end = weights(&case.samples, &mut w);
        let (expected, remainder) = definition(&case.taus);
        for (w, expected) in w.iter().zip(&expected) {
            assert!((f64::from(*w) - expected).abs() < 1e-6);
        }
        assert!((f64::from(end.transmittance) - remainder).abs() < 1e-6);
        assert!((w.iter().sum::<f32>() + end.transmittance - 1.0).abs() < 1e-6);
    }
}

#[test]
fn the_gradient_by_optical_depth_is_right_and_one_without_occlusion_is_not() {
    for seed in 0..8 {
        let case = case(seed);
        let mut w = vec![0.0; 16];
        let end = weights(&case.samples, &mut w).transmittance;
        let mut gradient = vec![0.0; 16];
        add_optical_depth_gradient(&w, &case.by_weight, end, case.by_end, &mut gradient);
        let loss = |taus: &[f64]| {
            let (w, end) = definition(taus);
            let pairs = w.iter().zip(&case.by_weight);
            pairs.map(|(w, g)| w * f64::from(*g)).sum::<f64>() + end * f64::from(case.by_end)
        };
        // Broken: as if a sample hid nothing behind it.
        let mut transmittance = 1.0;
        let broken: Vec<f64> = (0..16)
            .map(|i| {
                transmittance -= f64::from(w[i]);
                f64::from(case.by_weight[i]) * transmittance
            })
            .collect();
        let right: Vec<f64> = gradient.iter().map(|g| f64::from(*g)).collect();
        check(&case.taus, &loss, &right, &broken);
    }
}

#[test]
fn color_losses() {
    let (color, target, weight) = ([0.3f32, 0.7, 0.1], [0.5f32, 0.6, 0.4], 0.37f32);
    let x = color.map(f64::from);
    let squares = |c: &[f64]| {
        (0..3)
            .map(|i| (c[i] - f64::from(target[i])).powi(2))
            .sum::<f64>()
    };
    let right = color_loss(color, target).gradient.map(f64::from);
    check(&x, &|c| squares(c) / 3.0, &right, &right.map(|g| g * 3.0));
    let right = sample_color_loss(weight, color, target)
        .gradient
        .map(f64::from);
    check(
        &x,
        &|c| squares(c) * f64::from(weight),
        &right,
        &right.map(|g| -g),
    );
}

#[test]
fn entropy() {
    for t in [0.02f64, 0.3, 0.5001, 0.9] {
        let loss = |p: f64| -(p * p.ln() + (1.0 - p) * (1.0 - p).ln());
        let right = entropy_loss(t as f32);
        check_scalar(t, &loss, right, right.gradient + 1.0);
    }
    for t in [0.0, 1.0] {
        let at_the_end = entropy_loss(t);
        assert!(at_the_end.value.is_finite() && at_the_end.gradient == 0.0);
    }
}

#[test]
fn rectified_losses() {
    for tau in [0.05f64, 0.4, 1.5, 4.0] {
        let loss = |tau: f64| -(1.0 - (-tau).exp()).ln();
        let right = opaque_loss(tau as f32);
        check_scalar(tau, &loss, right, -1.0);
        check_scalar(
            tau,
            &|tau| tau,
            transparent_loss(tau as f32),
            right.gradient,
        );
    }
    // Held below its smallest optical depth: finite, and still asking for more density.
    let start = opaque_loss(0.0);
    assert!(start.value.is_finite() && start.gradient < -1.0 && start.gradient.is_finite());
}

#[test]
fn the_printed_rectified_loss_only_ever_raises_density() {
    for tau in [0.0, 0.1, 1.0, 5.0] {
        assert!(printed_rectified_loss(tau).gradient < 0.0);
        assert!(transparent_loss(tau).gradient > 0.0);
    }
}

#[test]
fn depth() {
    let (range, scale) = (10.0f32, 0.5f32);
    for t in [9.0f64, 9.7, 10.2, 12.0] {
        let loss = |t: f64| {
            let error = (t - 10.0).abs();
            if error < 0.5 {
                error * error
            } else {
                error - 0.25
            }
        };
        let right = depth_loss(t as f32, range, scale);
        check_scalar(t, &loss, right, 2.0 * right.gradient);
    }
}
