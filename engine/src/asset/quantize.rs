//! Rounding of stored values to fixed steps.

use half::f16;

use crate::field::{BRICK_NODES, FEATURES};

/// Finest step of raw densities: half of it changes sigma by at most 1.6 %, where softplus is exponential.
pub(super) const DENSITY_STEP: f32 = 1.0 / 32.0;
/// Widest step, for raw densities up to 32,767. Half of it is a factor of 1.6 in sigma: no wider step is worth storing.
const WIDEST_DENSITY_STEP: f32 = 1.0;
/// Steps of a feature on either side of 0. Four times as many cost a third more bytes and gain 0.02 dB.
const FEATURE_STEPS: f32 = 31.0;

/// The step that stores all of these raw densities: [`DENSITY_STEP`], doubled while the largest would not fit an i16. Levels
/// may hold large values against each other, and cutting one of them off would leave the other's. A power of two, so that
/// rounding stored values again changes nothing.
pub(super) fn density_step(raw: impl Iterator<Item = f32>) -> f32 {
    let largest = raw.fold(0.0, |m: f32, x| m.max(x.abs()));
    let mut step = DENSITY_STEP;
    while largest > step * f32::from(i16::MAX) && step < WIDEST_DENSITY_STEP {
        step *= 2.0;
    }
    step
}

/// A brick's raw densities in steps. What lies beyond 32,767 of the widest step is cut off.
///
/// # Panics
/// If one is not finite: training never returns such a field.
pub(super) fn density_steps(raw: &[f32], step: f32) -> Vec<i16> {
    assert!(raw.iter().all(|x| x.is_finite()), "densities are finite");
    raw.iter().map(|x| (x / step).round() as i16).collect()
}

/// A brick's features in steps of its channels' scales; the largest of each channel is [`FEATURE_STEPS`].
///
/// # Panics
/// If one is not finite.
pub(super) fn feature_steps(
    features: &[[f32; FEATURES]],
) -> ([[i8; FEATURES]; BRICK_NODES], [f16; FEATURES]) {
    let mut values = features.as_flattened().iter();
    assert!(values.all(|x| x.is_finite()), "features are finite");
    let scales: [f16; FEATURES] = std::array::from_fn(|f| {
        let largest = features.iter().fold(0.0, |m: f32, x| m.max(x[f].abs()));
        let scale = f16::from_f32(largest / FEATURE_STEPS).min(f16::MAX);
        // Below normal numbers a scale is itself too coarse; what it would scale is under 0.002.
        if scale.is_normal() { scale } else { f16::ZERO }
    });
    let mut steps = [[0; FEATURES]; BRICK_NODES];
    for (out, values) in steps.iter_mut().zip(features) {
        for f in 0..FEATURES {
            let scale = scales[f].to_f32();
            if scale > 0.0 {
                let step = (values[f] / scale).round();
                out[f] = step.clamp(-FEATURE_STEPS, FEATURE_STEPS) as i8;
            }
        }
    }
    (steps, scales)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn features_are_within_half_a_step_and_rounding_again_changes_nothing() {
        let mut features = [[0.0f32; FEATURES]; BRICK_NODES];
        for (n, node) in features.iter_mut().enumerate() {
            for (f, value) in node.iter_mut().enumerate() {
                *value =
                    ((n * 37 + f * 11) % 97) as f32 / 97.0 * 10f32.powi(f as i32 % 7 - 3) - 0.01;
            }
        }
        let (steps, scales) = feature_steps(&features);
        let mut again = features;
        for (n, node) in again.iter_mut().enumerate() {
            for (f, value) in node.iter_mut().enumerate() {
                let scale = scales[f].to_f32();
                *value = f32::from(steps[n][f]) * scale;
                assert!((*value - features[n][f]).abs() <= 0.51 * scale.max(0.016));
            }
        }
        assert_eq!(feature_steps(&again), (steps, scales));
    }

    #[test]
    fn densities_saturate_and_keep_zero() {
        let raw = [0.0, 0.015, -0.017, 5e4, -5e4, 1e30];
        let steps = density_steps(&raw, DENSITY_STEP);
        assert_eq!(steps, [0, 0, -1, i16::MAX, i16::MIN, i16::MAX]);
    }

    #[test]
    fn the_density_step_is_the_finest_that_holds_the_largest_and_stays_when_rounded_again() {
        for (largest, expected) in [
            (0.0, DENSITY_STEP),
            (1023.96, DENSITY_STEP),
            (1023.97, DENSITY_STEP * 2.0),
            (-1500.0, DENSITY_STEP * 2.0),
            (2047.94, DENSITY_STEP * 4.0),
            (1e30, WIDEST_DENSITY_STEP),
        ] {
            let raw = [largest, 0.2];
            let step = density_step(raw.into_iter());
            assert_eq!(step, expected, "{largest}");
            let steps = density_steps(&raw, step);
            let again = steps.iter().map(|x| f32::from(*x) * step);
            assert_eq!(density_step(again.clone()), step, "{largest}");
            assert_eq!(density_steps(&again.collect::<Vec<_>>(), step), steps);
        }
    }

    #[test]
    #[should_panic(expected = "features are finite")]
    fn a_feature_that_is_not_finite_is_never_stored() {
        let mut features = [[0.0f32; FEATURES]; BRICK_NODES];
        features[7][3] = f32::NAN;
        feature_steps(&features);
    }
}
