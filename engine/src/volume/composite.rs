//! Compositing along one ray.
//!
//! With optical depths `tau_i = sigma_i dt_i` and transmittance `T_1 = 1, T_(i+1) = T_i exp(-tau_i)`, sample i has weight
//! `w_i = T_i (1 - exp(-tau_i))` and the remainder `T_end = T_(n+1)` goes to what lies behind; weights and remainder sum to 1.
//! The ray's colour is `sum w_i c_i + T_end c_behind` and its range `sum w_i t_i + T_end t_behind`.

use super::real::Real;
use crate::field::RaySample;
use crate::field::transcendental::exp_m1;

/// What reaches the end of a ray.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Weights<R = f32> {
    /// Remaining transmittance, 0..1; accumulation is 1 minus this.
    pub transmittance: R,
    /// Total optical depth.
    pub tau: R,
}

/// Writes the weight of every sample to `out` (same length).
#[inline(always)]
pub fn weights(samples: &[RaySample], out: &mut [f32]) -> Weights {
    assert_eq!(samples.len(), out.len(), "one weight per sample");
    // Opacities on their own first: that loop vectorises, and only the product is sequential.
    for (sample, alpha) in samples.iter().zip(out.iter_mut()) {
        *alpha = -exp_m1(-(sample.sigma * sample.dt));
    }
    let (mut transmittance, mut tau) = (1.0f32, 0.0f32);
    for (sample, weight) in samples.iter().zip(out) {
        *weight *= transmittance;
        transmittance -= *weight;
        tau += sample.sigma * sample.dt;
    }
    Weights {
        transmittance: transmittance.max(0.0),
        tau,
    }
}

/// [`weights`] of samples with these optical depths, in any precision.
#[inline]
pub fn weights_of<R: Real>(taus: impl Iterator<Item = R>, out: &mut [R]) -> Weights<R> {
    let (mut transmittance, mut tau) = (R::ONE, R::ZERO);
    for (depth, weight) in taus.zip(out) {
        *weight = transmittance * -(-depth).exp_m1();
        transmittance -= *weight;
        tau += depth;
    }
    Weights {
        transmittance: transmittance.max(R::ZERO),
        tau,
    }
}

/// Adds dL/d(tau_i) of every sample to `out`, from the gradients of the loss by the weights and by the remainder.
///
/// `dL/dtau_i = g_i T_(i+1) - sum_(j>i) g_j w_j - g_end T_end`: a denser sample shows more of itself and hides what follows.
#[inline]
pub fn add_optical_depth_gradient<R: Real>(
    weights: &[R],
    weight_gradients: &[R],
    end_transmittance: R,
    end_gradient: R,
    out: &mut [R],
) {
    let mut transmittance = end_transmittance;
    let mut behind = end_gradient * end_transmittance;
    let pairs = weights.iter().zip(weight_gradients).zip(out);
    for ((weight, gradient), out) in pairs.rev() {
        *out += *gradient * transmittance - behind;
        behind += *gradient * *weight;
        transmittance += *weight;
    }
}
