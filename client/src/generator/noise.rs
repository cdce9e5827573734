//! Hashes and value noise: every pattern of the street is a pure function of position and seed.

use glam::Vec2;

/// Mixes integers to 32 well distributed bits (the finaliser of MurmurHash3).
pub(super) fn hash(a: u32, b: u32, c: u32) -> u32 {
    let mut h = a
        .wrapping_mul(0x9e37_79b1)
        .wrapping_add(b.wrapping_mul(0x85eb_ca77))
        .wrapping_add(c.wrapping_mul(0xc2b2_ae3d));
    h ^= h >> 16;
    h = h.wrapping_mul(0x85eb_ca6b);
    h ^= h >> 13;
    h = h.wrapping_mul(0xc2b2_ae35);
    h ^ (h >> 16)
}

/// Uniform in [0, 1).
pub(super) fn unit(a: u32, b: u32, c: u32) -> f32 {
    (hash(a, b, c) >> 8) as f32 * (1.0 / 16_777_216.0)
}

/// Standard normal by Box-Muller; `stream` separates independent uses of the same indices.
pub(super) fn gaussian(a: u32, b: u32, stream: u32) -> f64 {
    let u1 = f64::from(unit(a, b, stream.wrapping_mul(2))).max(1e-9);
    let u2 = f64::from(unit(a, b, stream.wrapping_mul(2).wrapping_add(1)));
    (-2.0 * libm::log(u1)).sqrt() * libm::cos(std::f64::consts::TAU * u2)
}

/// Largest integer not above `x`; several times faster than `f32::floor` where the baseline CPU has no instruction for it.
pub(super) fn floor(x: f32) -> i32 {
    let truncated = x as i32;
    truncated - i32::from(x < truncated as f32)
}

/// Smooth value noise in [-1, 1] with features of size 1.
pub(super) fn value(p: Vec2, seed: u32) -> f32 {
    let (i, j) = (floor(p.x), floor(p.y));
    let f = p - Vec2::new(i as f32, j as f32);
    let s = f * f * f * (f * (f * 6.0 - 15.0) + 10.0);
    let (i, j) = (i as u32, j as u32);
    let n = |di: u32, dj: u32| unit(i.wrapping_add(di), j.wrapping_add(dj), seed);
    let low = n(0, 0) + (n(1, 0) - n(0, 0)) * s.x;
    let high = n(0, 1) + (n(1, 1) - n(0, 1)) * s.x;
    (low + (high - low) * s.y) * 2.0 - 1.0
}

/// Fractal noise, roughly in [-1, 1]; octaves finer than twice the filter `width` fade out, so images do not alias.
pub(super) fn fractal(p: Vec2, feature: f32, octaves: u32, width: f32, seed: u32) -> f32 {
    let mut sum = 0.0;
    let (mut amplitude, mut size) = (0.5, feature);
    for octave in 0..octaves {
        let keep = 1.0 - smoothstep(0.35, 0.9, width / size);
        if keep <= 0.0 {
            break;
        }
        sum += keep * amplitude * value(p / size, seed.wrapping_add(octave * 101));
        amplitude *= 0.55;
        size *= 0.5;
    }
    sum
}

pub(super) fn smoothstep(low: f32, high: f32, x: f32) -> f32 {
    let t = ((x - low) / (high - low)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// Share of the interval of `width` around `x` that lies in [low, high]: a box-filtered stripe.
pub(super) fn stripe(x: f32, low: f32, high: f32, width: f32) -> f32 {
    let w = width.max(1e-5);
    let covered = (x + 0.5 * w).min(high) - (x - 0.5 * w).max(low);
    (covered / w).clamp(0.0, 1.0)
}

/// Share of the interval of `width` around `x` covered by stripes [0, duty] repeated with period 1.
pub(super) fn stripes(x: f32, duty: f32, width: f32) -> f32 {
    let w = width.max(1e-5);
    let integral = |t: f32| {
        let whole = floor(t) as f32;
        whole * duty + (t - whole).min(duty)
    };
    ((integral(x + 0.5 * w) - integral(x - 0.5 * w)) / w).clamp(0.0, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Mean of a function over the interval of `width` around `x`.
    fn mean(f: impl Fn(f32) -> f32, x: f32, width: f32) -> f32 {
        const STEPS: u32 = 4000;
        let at = |i: u32| x + width * ((i as f32 + 0.5) / STEPS as f32 - 0.5);
        (0..STEPS).map(|i| f(at(i))).sum::<f32>() / STEPS as f32
    }

    #[test]
    fn filtered_stripes_are_box_filtered() {
        let comb = |t: f32| if t - t.floor() < 0.3 { 1.0 } else { 0.0 };
        let single = |t: f32| if (0.2..0.6).contains(&t) { 1.0 } else { 0.0 };
        for i in 0..40 {
            let (x, width) = (-2.0 + 0.17 * i as f32, 0.05 + 0.09 * (i % 7) as f32);
            assert!(
                (stripes(x, 0.3, width) - mean(comb, x, width)).abs() < 2e-3,
                "stripes at {x}"
            );
            assert!(
                (stripe(x, 0.2, 0.6, width) - mean(single, x, width)).abs() < 2e-3,
                "stripe at {x}"
            );
        }
    }

    #[test]
    fn fractal_noise_fades_below_the_filter_width() {
        let spread = |width: f32| {
            let samples: Vec<f32> = (0..400)
                .map(|i| {
                    fractal(
                        Vec2::new(0.37 * i as f32, 0.11 * i as f32),
                        0.5,
                        4,
                        width,
                        3,
                    )
                })
                .collect();
            samples.iter().map(|v| v * v).sum::<f32>() / samples.len() as f32
        };
        assert!(spread(0.001) > 0.02);
        assert!(spread(0.25) < spread(0.001));
        assert_eq!(spread(2.0), 0.0);
    }

    #[test]
    fn floor_agrees_with_the_library() {
        for x in [-2.0_f32, -1.5, -0.0, 0.0, 0.99, 1.0, 7.3] {
            assert_eq!(floor(x), x.floor() as i32, "{x}");
        }
    }
}
