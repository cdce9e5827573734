//! Every gradient against f64 central differences, in f32 and in f64, and every check against a formula broken on purpose.

use super::*;
use crate::field::RaySample;
use crate::scene::Draws;

/// Largest relative error between f32 gradients and f64 differences: rounding of 16 samples' sums stays near 1e-5.
const TOLERANCE: f64 = 1e-3;
/// The same formulas run in f64.
const TOLERANCE_F64: f64 = 1e-6;
/// Step of the central differences: truncation h^2 and rounding 1e-16 / h both stay below 1e-9.
const H: f64 = 1e-5;

/// Largest difference relative to the largest gradient.
fn relative_error(analytic: &[f64], numeric: &[f64]) -> f64 {
    assert_eq!(analytic.len(), numeric.len());
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

/// Accepts the gradient as computed in f64 and in f32, and rejects the broken one.
fn check(x: &[f64], loss: &dyn Fn(&[f64]) -> f64, double: &[f64], single: &[f64], broken: &[f64]) {
    let numeric = differences(x, loss);
    let error = relative_error(double, &numeric);
    assert!(error < TOLERANCE_F64, "f64: relative error {error}");
    let error = relative_error(single, &numeric);
    assert!(error < TOLERANCE, "f32: relative error {error}");
    let error = relative_error(broken, &numeric);
    assert!(
        error > 10.0 * TOLERANCE,
        "a broken gradient passes with {error}"
    );
}

fn check_scalar(
    x: f64,
    loss: &dyn Fn(f64) -> f64,
    double: Loss<f64>,
    single: Loss<f32>,
    broken: f64,
) {
    let value = loss(x);
    assert!((double.value - value).abs() < TOLERANCE_F64 * value.abs().max(1.0));
    assert!((f64::from(single.value) - value).abs() < TOLERANCE * value.abs().max(1.0));
    let loss = |x: &[f64]| loss(x[0]);
    let single = f64::from(single.gradient);
    check(&[x], &loss, &[double.gradient], &[single], &[broken]);
}

fn cast<R: Real>(values: &[f64]) -> Vec<R> {
    values.iter().map(|x| R::of(*x)).collect()
}

fn doubles<R: Real>(values: &[R]) -> Vec<f64> {
    values.iter().map(|x| x.to_f64()).collect()
}

fn triple<R: Real>(values: &[f64]) -> [R; 3] {
    std::array::from_fn(|c| R::of(values[c]))
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
    by_weight: Vec<f64>,
    by_end: f64,
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
        taus: samples.iter().map(|s| f64::from(s.sigma * s.dt)).collect(),
        by_weight: samples.iter().map(|_| draws.jitter(2.0)).collect(),
        by_end: draws.jitter(2.0),
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

/// The gradient of a case's linear loss by optical depths, as computed in `R`.
fn by_optical_depth<R: Real>(case: &Case) -> Vec<f64> {
    let mut w = vec![R::ZERO; case.taus.len()];
    let end = weights_of(cast(&case.taus).into_iter(), &mut w).transmittance;
    let mut gradient = vec![R::ZERO; w.len()];
    let by_weight = cast(&case.by_weight);
    add_optical_depth_gradient(&w, &by_weight, end, R::of(case.by_end), &mut gradient);
    doubles(&gradient)
}

#[test]
fn the_gradient_by_optical_depth_is_right_and_one_without_occlusion_is_not() {
    for seed in 0..8 {
        let case = case(seed);
        let loss = |taus: &[f64]| {
            let (w, end) = definition(taus);
            let pairs = w.iter().zip(&case.by_weight);
            pairs.map(|(w, g)| w * g).sum::<f64>() + end * case.by_end
        };
        // Broken: as if a sample hid nothing behind it.
        let mut transmittance = 1.0;
        let broken: Vec<f64> = (definition(&case.taus).0.iter().zip(&case.by_weight))
            .map(|(w, g)| {
                transmittance -= w;
                g * transmittance
            })
            .collect();
        let (double, single) = (
            by_optical_depth::<f64>(&case),
            by_optical_depth::<f32>(&case),
        );
        check(&case.taus, &loss, &double, &single, &broken);
    }
}

const COLOR: [f64; 3] = [0.3, 0.7, 0.1];
const TARGET: [f64; 3] = [0.5, 0.6, 0.4];

#[test]
fn color_losses() {
    fn of<R: Real>() -> Vec<f64> {
        doubles(&color_loss::<R>(triple(&COLOR), triple(&TARGET)).gradient)
    }
    fn per_sample<R: Real>() -> Vec<f64> {
        let (color, target) = (triple(&COLOR), triple(&TARGET));
        doubles(&sample_color_loss::<R>(R::of(0.37), color, target).gradient)
    }
    let squares = |c: &[f64]| (0..3).map(|i| (c[i] - TARGET[i]).powi(2)).sum::<f64>();
    let broken: Vec<f64> = of::<f64>().iter().map(|g| g * 3.0).collect();
    let loss = |c: &[f64]| squares(c) / 3.0;
    check(&COLOR, &loss, &of::<f64>(), &of::<f32>(), &broken);
    let broken: Vec<f64> = per_sample::<f64>().iter().map(|g| -g).collect();
    let (double, single) = (per_sample::<f64>(), per_sample::<f32>());
    check(&COLOR, &|c| 0.37 * squares(c), &double, &single, &broken);
}

#[test]
fn entropy() {
    for t in [0.02f64, 0.3, 0.5001, 0.9] {
        let loss = |p: f64| -(p * p.ln() + (1.0 - p) * (1.0 - p).ln());
        let double = entropy_loss(t);
        let broken = double.gradient + 1.0;
        check_scalar(t, &loss, double, entropy_loss(t as f32), broken);
    }
    for t in [0.0f32, 1.0] {
        let at_the_end = entropy_loss(t);
        assert!(at_the_end.value.is_finite() && at_the_end.gradient == 0.0);
    }
}

#[test]
fn rectified_losses() {
    for tau in [0.05f64, 0.4, 1.5, 4.0] {
        let loss = |tau: f64| -(1.0 - (-tau).exp()).ln();
        let double = opaque_loss(tau);
        check_scalar(tau, &loss, double, opaque_loss(tau as f32), -1.0);
        let through = (transparent_loss(tau), transparent_loss(tau as f32));
        check_scalar(tau, &|tau| tau, through.0, through.1, double.gradient);
    }
    // Held below its smallest optical depth: finite, and still asking for more density.
    let start = opaque_loss(0.0f32);
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
    for t in [9.0f64, 9.7, 10.2, 12.0] {
        let loss = |t: f64| {
            let error = (t - 10.0).abs();
            if error < 0.5 {
                error * error
            } else {
                error - 0.25
            }
        };
        let double = depth_loss(t, 10.0, 0.5);
        let single = depth_loss(t as f32, 10.0, 0.5);
        check_scalar(t, &loss, double, single, 2.0 * double.gradient);
        let absolute = |t: f64| (t - 10.0).abs();
        let double = composited_depth_loss(t, 10.0);
        let single = composited_depth_loss(t as f32, 10.0);
        check_scalar(t, &absolute, double, single, -double.gradient);
    }
}

/// L1 of the composited range by optical depths: through weights and remainder, as training applies it.
fn composited_depth_gradient<R: Real>(case: &Case, behind_m: f64, range_m: f64) -> Vec<f64> {
    let mut w = vec![R::ZERO; case.taus.len()];
    let end = weights_of(cast(&case.taus).into_iter(), &mut w).transmittance;
    let ts: Vec<R> = case.samples.iter().map(|s| R::of(s.t.into())).collect();
    let composited = (w.iter().zip(&ts)).fold(end * R::of(behind_m), |sum, (w, t)| sum + *w * *t);
    let slope = composited_depth_loss(composited, R::of(range_m)).gradient;
    let by_weight: Vec<R> = ts.iter().map(|t| slope * *t).collect();
    let mut gradient = vec![R::ZERO; w.len()];
    let by_end = slope * R::of(behind_m);
    add_optical_depth_gradient(&w, &by_weight, end, by_end, &mut gradient);
    doubles(&gradient)
}

#[test]
fn the_composited_range_is_differentiable_and_leaving_out_the_remainder_is_wrong() {
    for (seed, range_m) in [(0, 1.2), (1, 3.5), (2, 1.9)] {
        let case = case(seed);
        let loss = |taus: &[f64]| {
            let (w, end) = definition(taus);
            let range = (w.iter().zip(&case.samples)).map(|(w, s)| w * f64::from(s.t));
            (range.sum::<f64>() + end * 4.0 - range_m).abs()
        };
        check(
            &case.taus,
            &loss,
            &composited_depth_gradient::<f64>(&case, 4.0, range_m),
            &composited_depth_gradient::<f32>(&case, 4.0, range_m),
            &composited_depth_gradient::<f64>(&case, 0.0, range_m),
        );
    }
}

/// Weights, warped positions and lengths of a case's samples.
fn warped_samples(case: &Case) -> Vec<(f64, f64, f64)> {
    let (w, _) = definition(&case.taus);
    let samples = w.iter().zip(&case.samples).map(|(w, sample)| {
        let (s, slope) = warped(f64::from(sample.t), 2.0);
        (*w, s, slope * f64::from(sample.dt))
    });
    samples.collect()
}

fn distortion_gradient<R: Real>(samples: &[(f64, f64, f64)]) -> (f64, Vec<f64>) {
    let samples: Vec<(R, R, R)> = (samples.iter())
        .map(|s| (R::of(s.0), R::of(s.1), R::of(s.2)))
        .collect();
    let mut out = vec![R::ZERO; samples.len()];
    let loss = add_distortion_gradient(samples.iter().copied(), R::ONE, &mut out);
    (loss.to_f64(), doubles(&out))
}

#[test]
fn the_linear_time_distortion_is_the_double_sum_and_its_gradient_is_right() {
    for seed in 0..4 {
        let samples = warped_samples(&case(seed));
        let pairs = |w: &[f64], own: f64| {
            let mut sum = 0.0;
            for (i, a) in samples.iter().enumerate() {
                for (j, b) in samples.iter().enumerate() {
                    sum += w[i] * w[j] * (a.1 - b.1).abs();
                }
                sum += own * w[i] * w[i] * a.2;
            }
            sum
        };
        let loss = |w: &[f64]| pairs(w, 1.0 / 3.0);
        let w: Vec<f64> = samples.iter().map(|s| s.0).collect();
        let (value, double) = distortion_gradient::<f64>(&samples);
        assert!((value - loss(&w)).abs() < 1e-12);
        let (_, single) = distortion_gradient::<f32>(&samples);
        // Broken: every pair counted once instead of twice.
        let broken: Vec<f64> = double.iter().map(|g| g / 2.0).collect();
        check(&w, &loss, &double, &single, &broken);
    }
}

#[test]
fn the_warped_coordinate_has_the_slope_it_says() {
    for t in [0.5, 3.0, 40.0] {
        let (s, slope) = warped(t, 8.0);
        let numeric = differences(&[t], &|t| t[0] / (t[0] + 8.0))[0];
        assert!((slope - numeric).abs() < 1e-9 && s < 1.0);
    }
}

#[test]
fn variation_is_clamped_and_its_slope_right() {
    for d in [-3.0f64, -0.4, 0.2, 0.9, 1.7] {
        let loss = |d: f64| {
            if d.abs() < 1.0 {
                d * d / 2.0
            } else {
                d.abs() - 0.5
            }
        };
        let double = variation_loss(d);
        assert_eq!(double.gradient, d.clamp(-1.0, 1.0));
        let broken = double.gradient * 1.5;
        check_scalar(d, &loss, double, variation_loss(d as f32), broken);
    }
}

/// Gradients by colour, log gain and bias, in this order.
fn exposure_gradient<R: Real>(x: &[f64]) -> Vec<f64> {
    let exposure = Exposure::<R> {
        log_gain: triple(&x[3..]),
        bias: triple(&x[6..]),
    };
    let color = triple(x);
    let by_corrected = color_loss(exposure.apply(color), triple(&TARGET)).gradient;
    let gradient = exposure.gradient(color, by_corrected);
    [gradient.color, gradient.log_gain, gradient.bias]
        .map(|g| doubles(&g))
        .concat()
}

#[test]
fn exposure_gradients_are_right_and_ignoring_the_gain_is_wrong() {
    let x = [0.3, 0.7, 0.1, 0.4, -0.3, 0.2, 0.05, -0.02, 0.1];
    let loss = |x: &[f64]| {
        let corrected = (0..3).map(|c| x[3 + c].exp() * x[c] + x[6 + c]);
        let squares = corrected.zip(TARGET).map(|(a, b)| (a - b).powi(2));
        squares.sum::<f64>() / 3.0
    };
    let (double, single) = (exposure_gradient::<f64>(&x), exposure_gradient::<f32>(&x));
    // Broken: the colour's gradient passed on as if the gain were 1.
    let mut broken = double.clone();
    (0..3).for_each(|c| broken[c] = double[6 + c]);
    check(&x, &loss, &double, &single, &broken);
}
