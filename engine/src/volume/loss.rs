//! Losses of one ray and their gradients. Means over a batch and weights are the caller's.

use super::real::Real;

/// A value and its derivative by the quantity the function names.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Loss<R = f32, G = R> {
    pub value: R,
    pub gradient: G,
}

/// Below this optical depth the gradient of [`opaque_loss`] (about -1/tau) is held, or it would explode at initialisation.
const TAU_MIN: f64 = 1e-2;
/// Bounds of the probability inside the entropy, as in DVGO.
const ENTROPY_MIN: f64 = 1e-6;

/// Mean squared error over the three channels; gradient by the composited colour.
#[inline]
pub fn color_loss<R: Real>(color: [R; 3], target: [R; 3]) -> Loss<R, [R; 3]> {
    let error: [R; 3] = std::array::from_fn(|c| color[c] - target[c]);
    let [r, g, b] = error;
    Loss {
        value: (r * r + g * g + b * b) / R::of(3.0),
        gradient: error.map(|e| R::of(2.0) * e / R::of(3.0)),
    }
}

/// DVGO's `rgbper`: every sample's own colour error, weighted by its weight, which is held constant; gradient by the sample's colour.
#[inline]
pub fn sample_color_loss<R: Real>(weight: R, color: [R; 3], target: [R; 3]) -> Loss<R, [R; 3]> {
    let error: [R; 3] = std::array::from_fn(|c| color[c] - target[c]);
    let [r, g, b] = error;
    Loss {
        value: weight * (r * r + g * g + b * b),
        gradient: error.map(|e| R::of(2.0) * weight * e),
    }
}

/// DVGO's `entropy_last`: entropy of the remaining transmittance, which favours all or nothing; gradient by it.
#[inline]
pub fn entropy_loss<R: Real>(transmittance: R) -> Loss<R> {
    let p = transmittance
        .max(R::of(ENTROPY_MIN))
        .min(R::of(1.0 - ENTROPY_MIN));
    let q = R::ONE - p;
    Loss {
        value: -(p * p.ln() + q * q.ln()),
        gradient: if p == transmittance {
            q.ln() - p.ln()
        } else {
            R::ZERO
        },
    }
}

/// Rectified loss of a ray known to hit: `-ln P` with `P = 1 - exp(-tau)`; gradient by the ray's optical depth tau.
///
/// With [`transparent_loss`] this is the binary cross-entropy `-(m ln P + (1 - m) ln(1 - P))`.
#[inline]
pub fn opaque_loss<R: Real>(tau: R) -> Loss<R> {
    let held = tau.max(R::of(TAU_MIN));
    Loss {
        value: -(-(-held).exp_m1()).ln() + (held - tau) / held.exp_m1(),
        gradient: -(R::ONE / held.exp_m1()),
    }
}

/// Rectified loss of a ray known to pass: `-ln(1 - P) = tau` exactly; gradient by tau.
#[inline]
pub fn transparent_loss<R: Real>(tau: R) -> Loss<R> {
    Loss {
        value: tau,
        gradient: R::ONE,
    }
}

/// The rectified loss as the paper prints it: `-ln P` for every ray. It can only raise density; kept for ablation.
#[inline]
pub fn printed_rectified_loss<R: Real>(tau: R) -> Loss<R> {
    opaque_loss(tau)
}

/// Robust depth of one sample: Huber of the error in metres, quadratic below `scale_m`, with slope 1 beyond; gradient by `t`.
///
/// Applied per sample and weighted by the sample's weight it is the expected error of a ray's range distribution,
/// which is 0 only if all weight lies at the return.
#[inline]
pub fn depth_loss<R: Real>(t: R, range_m: R, scale_m: R) -> Loss<R> {
    let error = t - range_m;
    let half = R::of(0.5);
    if error.abs() < scale_m {
        Loss {
            value: half * error * error / scale_m,
            gradient: error / scale_m,
        }
    } else {
        Loss {
            value: error.abs() - half * scale_m,
            gradient: error.signum(),
        }
    }
}

/// The paper's depth loss: absolute error in metres of the composited range `sum w_i t_i + T_end t_behind`; gradient by it.
///
/// The range's own gradients are `t_i` by weight i and `t_behind` by the remainder.
#[inline]
pub fn composited_depth_loss<R: Real>(composited_m: R, range_m: R) -> Loss<R> {
    let error = composited_m - range_m;
    Loss {
        value: error.abs(),
        gradient: error.signum(),
    }
}

/// Total variation between two neighbouring nodes as DVGO's kernel has it: slope `clamp(difference, -1, 1)`; gradient by
/// `difference`. A node's gradient is the sum over its six neighbours divided by 6.
#[inline]
pub fn variation_loss<R: Real>(difference: R) -> Loss<R> {
    depth_loss(difference, R::ZERO, R::ONE)
}
