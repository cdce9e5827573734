//! Between sRGB, in which fields are trained and composited, and linear light, in which shadows and sunlight multiply.

/// IEC 61966-2-1, decoding: 0..=1 to 0..=1.
pub(super) fn linear_of(encoded: f64) -> f64 {
    if encoded <= 0.040_45 {
        encoded / 12.92
    } else {
        libm::pow((encoded + 0.055) / 1.055, 2.4)
    }
}

/// IEC 61966-2-1, encoding.
pub(super) fn srgb_of(linear: f64) -> f64 {
    if linear <= 0.003_130_8 {
        linear * 12.92
    } else {
        1.055 * libm::pow(linear, 1.0 / 2.4) - 0.055
    }
}

/// Scales an sRGB colour by one factor a channel in linear light; what exceeds white is white.
pub(super) fn scale(rgb: [f32; 3], factor: [f64; 3]) -> [f32; 3] {
    std::array::from_fn(|c| {
        let linear = linear_of(f64::from(rgb[c])) * factor[c];
        srgb_of(linear.min(1.0)) as f32
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn light_is_scaled_in_linear_space() {
        // 188 is half of full linear light, so a quarter remains: 137.
        let half = scale([188.0 / 255.0; 3], [0.5, 1.0, 9.0]);
        assert!((half[0] * 255.0 - 137.0).abs() < 0.5);
        assert!((half[1] * 255.0 - 188.0).abs() < 1e-3);
        assert!((half[2] - 1.0).abs() < 1e-6);
        assert_eq!(scale([0.0; 3], [0.5; 3]), [0.0; 3]);
        // Scaling the encoded value instead would give 94.
        assert!((half[0] * 255.0 - 94.0).abs() > 40.0);
    }
}
