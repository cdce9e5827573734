//! The distortion loss of mip-NeRF 360 (Barron et al. 2022, eq. 15) in time linear in the samples, as DVGO-v2 computes it.
//!
//! `L = sum_ij w_i w_j |s_i - s_j| + 1/3 sum_i w_i^2 l_i` with samples at `s_i`, ascending, in intervals of length `l_i`. It
//! draws a ray's weight together. Its coordinate is `s = t / (t + c)`: `t / c` near the camera, and bounded far from it, where
//! one metre is less than a pixel.

use super::real::Real;

/// The warped coordinate of a range and its derivative: `t / (t + c)` and `c / (t + c)^2`.
#[inline]
pub fn warped<R: Real>(t: R, scale_m: R) -> (R, R) {
    let sum = t + scale_m;
    (t / sum, scale_m / (sum * sum))
}

/// Adds `factor` times dL/dw_i to `out` and returns L. `samples` yields the weight, position and length of each, near to far.
#[inline]
pub fn add_distortion_gradient<R: Real>(
    samples: impl Iterator<Item = (R, R, R)> + Clone,
    factor: R,
    out: &mut [R],
) -> R {
    let (mut weight_all, mut moment_all) = (R::ZERO, R::ZERO);
    for (weight, s, _) in samples.clone() {
        weight_all += weight;
        moment_all += weight * s;
    }
    let third = R::of(1.0 / 3.0);
    let two = R::of(2.0);
    let (mut weight_before, mut moment_before) = (R::ZERO, R::ZERO);
    let mut loss = R::ZERO;
    for ((weight, s, length), out) in samples.zip(out) {
        let (weight_after, moment_after) = (
            weight_all - weight_before - weight,
            moment_all - moment_before - weight * s,
        );
        let spread = s * (weight_before - weight_after) + moment_after - moment_before;
        let own = third * weight * length;
        loss += weight * (spread + own);
        *out += factor * two * (spread + own);
        weight_before += weight;
        moment_before += weight * s;
    }
    loss
}
