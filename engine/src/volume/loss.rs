//! Losses of one ray and their gradients. Means over a batch and weights are the caller's.

/// A value and its derivative by the quantity the function names.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Loss<G = f32> {
    pub value: f32,
    pub gradient: G,
}

/// Below this optical depth the gradient of [`opaque_loss`] (about -1/tau) is held, or it would explode at initialisation.
const TAU_MIN: f32 = 1e-2;
/// Bounds of the probability inside the entropy, as in DVGO.
const ENTROPY_MIN: f32 = 1e-6;

/// Mean squared error over the three channels; gradient by the composited colour.
#[inline]
pub fn color_loss(color: [f32; 3], target: [f32; 3]) -> Loss<[f32; 3]> {
    let error = std::array::from_fn(|c| color[c] - target[c]);
    let [r, g, b]: [f32; 3] = error;
    Loss {
        value: (r * r + g * g + b * b) / 3.0,
        gradient: error.map(|e| 2.0 * e / 3.0),
    }
}

/// DVGO's `rgbper`: every sample's own colour error, weighted by its weight, which is held constant; gradient by the sample's colour.
#[inline]
pub fn sample_color_loss(weight: f32, color: [f32; 3], target: [f32; 3]) -> Loss<[f32; 3]> {
    let error: [f32; 3] = std::array::from_fn(|c| color[c] - target[c]);
    let [r, g, b] = error;
    Loss {
        value: weight * (r * r + g * g + b * b),
        gradient: error.map(|e| 2.0 * weight * e),
    }
}

/// DVGO's `entropy_last`: entropy of the remaining transmittance, which favours all or nothing; gradient by it.
#[inline]
pub fn entropy_loss(transmittance: f32) -> Loss {
    let p = transmittance.clamp(ENTROPY_MIN, 1.0 - ENTROPY_MIN);
    let inside = p == transmittance;
    Loss {
        value: -(p * p.ln() + (1.0 - p) * (1.0 - p).ln()),
        gradient: if inside { (1.0 - p).ln() - p.ln() } else { 0.0 },
    }
}

/// Rectified loss of a ray known to hit: `-ln P` with `P = 1 - exp(-tau)`; gradient by the ray's optical depth tau.
///
/// With [`transparent_loss`] this is the binary cross-entropy `-(m ln P + (1 - m) ln(1 - P))`.
#[inline]
pub fn opaque_loss(tau: f32) -> Loss {
    let held = tau.max(TAU_MIN);
    Loss {
        value: -(-(-held).exp_m1()).ln() + (held - tau) / held.exp_m1(),
        gradient: -1.0 / held.exp_m1(),
    }
}

/// Rectified loss of a ray known to pass: `-ln(1 - P) = tau` exactly; gradient by tau.
#[inline]
pub fn transparent_loss(tau: f32) -> Loss {
    Loss {
        value: tau,
        gradient: 1.0,
    }
}

/// The rectified loss as the paper prints it: `-ln P` for every ray. It can only raise density; kept for ablation.
#[inline]
pub fn printed_rectified_loss(tau: f32) -> Loss {
    opaque_loss(tau)
}

/// Robust depth of one sample or of a composited range: Huber of the error in metres, quadratic below `scale_m`,
/// with slope 1 beyond; gradient by `t`.
///
/// Applied per sample and weighted by the sample's weight it is the expected error of a ray's range distribution,
/// which is 0 only if all weight lies at the return.
#[inline]
pub fn depth_loss(t: f32, range_m: f32, scale_m: f32) -> Loss {
    let error = t - range_m;
    if error.abs() < scale_m {
        Loss {
            value: 0.5 * error * error / scale_m,
            gradient: error / scale_m,
        }
    } else {
        Loss {
            value: error.abs() - 0.5 * scale_m,
            gradient: error.signum(),
        }
    }
}
