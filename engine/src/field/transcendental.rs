//! Exponentials in plain arithmetic: without branches and calls, so that loops over them vectorise, and bit-equal on every
//! machine, which the platform's own are not.
//!
//! Each is within [`RELATIVE_ERROR`] of the true value.

/// Largest relative error of the functions here; the tests hold them to it.
pub const RELATIVE_ERROR: f32 = 4e-7;

/// ln 2 in two parts: the first has so few bits that whole multiples of it are exact (Cody and Waite).
const LN_2_HIGH: f32 = 0.693_359_4;
const LN_2_LOW: f32 = -2.121_944_4e-4;
/// Beyond this e^x leaves the normal f32 numbers.
const X_MAX: f32 = 87.0;
/// 1.5 * 2^23: adding it rounds to a whole number that then stands in the low mantissa bits.
const ROUNDER: f32 = 12_582_912.0;

/// 2^n as a float and e^r - 1 with x = n ln 2 + r and |r| <= ln 2 / 2.
#[inline(always)]
fn split(x: f32) -> (f32, f32) {
    let shifted = x * std::f32::consts::LOG2_E + ROUNDER;
    let n = shifted - ROUNDER;
    let r = (x - n * LN_2_HIGH) - n * LN_2_LOW;
    let power = f32::from_bits(
        shifted
            .to_bits()
            .wrapping_sub(ROUNDER.to_bits())
            .wrapping_add(127)
            << 23,
    );
    // Taylor's series to the seventh power: the next term is 1e-8 of e^r - 1 at the ends.
    let p = 1.0 / 5040.0;
    let p = p * r + 1.0 / 720.0;
    let p = p * r + 1.0 / 120.0;
    let p = p * r + 1.0 / 24.0;
    let p = p * r + 1.0 / 6.0;
    let p = p * r + 0.5;
    (power, p * r * r + r)
}

/// e^x; x is held within +-87.
#[inline(always)]
pub fn exp(x: f32) -> f32 {
    let (power, less_one) = split(x.clamp(-X_MAX, X_MAX));
    power * less_one + power
}

/// e^x - 1; x is held within +-87.
#[inline(always)]
pub fn exp_m1(x: f32) -> f32 {
    let (power, less_one) = split(x.clamp(-X_MAX, X_MAX));
    power * less_one + (power - 1.0)
}

/// ln(1 + y) for y in 0..=1.
#[inline(always)]
fn ln_1p(y: f32) -> f32 {
    // 2 artanh(s), s = y / (2 + y) <= 1/3: the first term left out is 2e-8 of the sum.
    let s = y / (2.0 + y);
    let q = s * s;
    let p = 1.0 / 13.0;
    let p = p * q + 1.0 / 11.0;
    let p = p * q + 1.0 / 9.0;
    let p = p * q + 1.0 / 7.0;
    let p = p * q + 1.0 / 5.0;
    let p = p * q + 1.0 / 3.0;
    2.0 * s + 2.0 * s * q * p
}

/// ln(1 + e^x) without overflow.
#[inline(always)]
pub fn softplus(x: f32) -> f32 {
    x.max(0.0) + ln_1p(exp(-x.abs()))
}

/// 1 / (1 + e^-x) without overflow.
#[inline(always)]
pub fn sigmoid(x: f32) -> f32 {
    let e = exp(-x.abs());
    let numerator = if x >= 0.0 { 1.0 } else { e };
    numerator / (1.0 + e)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn worst(f: impl Fn(f32) -> f32, exact: impl Fn(f64) -> f64, low: f32, high: f32) -> f64 {
        let n = 200_000;
        let at = |i: i32| low + (high - low) * i as f32 / n as f32;
        (0..=n).map(at).fold(0.0, |worst: f64, x| {
            let exact = exact(f64::from(x));
            let error = (f64::from(f(x)) - exact).abs();
            worst.max(if error == 0.0 {
                0.0
            } else {
                error / exact.abs()
            })
        })
    }

    #[test]
    fn all_are_within_the_stated_error() {
        let bound = f64::from(RELATIVE_ERROR);
        for (low, high) in [(-80.0, 80.0), (-1.0, 1.0), (-1e-3, 1e-3)] {
            assert!(worst(exp, f64::exp, low, high) < bound);
            assert!(worst(exp_m1, f64::exp_m1, low, high) < bound);
            assert!(worst(softplus, |x| x.exp().ln_1p(), low.max(-40.0), high) < bound);
            assert!(worst(sigmoid, |x| 1.0 / (1.0 + (-x).exp()), low, high) < bound);
        }
        // The measure sees a wrong function: the plain difference loses all digits near 0.
        assert!(worst(|x| exp(x) - 1.0, f64::exp_m1, -1e-3, 1e-3) > bound);
    }

    #[test]
    fn the_ends_stay_finite() {
        for x in [f32::NEG_INFINITY, -1e30, -200.0, 200.0, 1e30] {
            assert!(exp(x).is_finite() && exp_m1(x).is_finite() && sigmoid(x).is_finite());
        }
        assert_eq!(exp_m1(-200.0), -1.0);
        assert_eq!(softplus(200.0), 200.0);
        assert_eq!(exp(0.0), 1.0);
        assert_eq!(exp_m1(0.0), 0.0);
    }
}
