//! Rounding of stored values to fixed steps.

use half::f16;

use crate::field::{BRICK_NODES, FEATURES};

/// Step of raw densities: half of it changes sigma by at most 1.6 %, where softplus is exponential.
pub(super) const DENSITY_STEP: f32 = 1.0 / 32.0;
/// Steps of a feature on either side of 0. Four times as many cost a third more bytes and gain 0.02 dB.
const FEATURE_STEPS: f32 = 31.0;

/// A brick's raw densities in steps. What lies beyond 1,000 is as opaque or as empty as an f32 sigma can say.
///
/// # Panics
/// If one is not finite: training never returns such a field.
pub(super) fn density_steps(raw: &[f32]) -> Vec<i16> {
    assert!(raw.iter().all(|x| x.is_finite()), "densities are finite");
    raw.iter()
        .map(|x| (x / DENSITY_STEP).round() as i16)
        .collect()
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
        let steps = density_steps(&raw);
        assert_eq!(steps, [0, 0, -1, i16::MAX, i16::MIN, i16::MAX]);
    }

    #[test]
    #[should_panic(expected = "features are finite")]
    fn a_feature_that_is_not_finite_is_never_stored() {
        let mut features = [[0.0f32; FEATURES]; BRICK_NODES];
        features[7][3] = f32::NAN;
        feature_steps(&features);
    }
}
