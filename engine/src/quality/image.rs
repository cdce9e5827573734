//! Image similarity over masked pixels.

/// Edge of the SSIM window in pixels.
const WINDOW: usize = 7;
/// (0.01)^2 and (0.03)^2 for values in 0..1, from Wang et al. 2004.
const C1: f64 = 1e-4;
const C2: f64 = 9e-4;

/// Peak signal-to-noise ratio in decibels of a mean squared error of values in 0..1.
pub fn psnr_db(mean_squared_error: f64) -> f64 {
    -10.0 * mean_squared_error.max(1e-12).log10()
}

/// Mean structural similarity (7x7 uniform window) of the windows whose pixels are all in `mask`; `None` if there is none.
///
/// Images are row-major sRGB in 0..1, `width * height` pixels; the similarity is the mean over the three channels.
pub fn ssim(
    width: usize,
    height: usize,
    a: &[[f32; 3]],
    b: &[[f32; 3]],
    mask: &[bool],
) -> Option<f64> {
    assert!(a.len() == width * height && b.len() == a.len() && mask.len() == a.len());
    let (mut sum, mut windows) = (0.0, 0u64);
    // Every second window: neighbours overlap by six sevenths, so the mean hardly changes.
    for y in (0..(height + 1).saturating_sub(WINDOW)).step_by(2) {
        for x in (0..(width + 1).saturating_sub(WINDOW)).step_by(2) {
            let pixels = (0..WINDOW * WINDOW).map(|i| (y + i / WINDOW) * width + x + i % WINDOW);
            if pixels.clone().all(|p| mask[p]) {
                let similarity = (0..3).map(|c| window(pixels.clone().map(|p| (a[p][c], b[p][c]))));
                sum += similarity.sum::<f64>() / 3.0;
                windows += 1;
            }
        }
    }
    (windows > 0).then(|| sum / windows as f64)
}

fn window(pairs: impl Iterator<Item = (f32, f32)>) -> f64 {
    let (mut n, mut sa, mut sb, mut saa, mut sbb, mut sab) = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
    for (a, b) in pairs {
        let (a, b) = (f64::from(a), f64::from(b));
        n += 1.0;
        sa += a;
        sb += b;
        saa += a * a;
        sbb += b * b;
        sab += a * b;
    }
    let (ma, mb) = (sa / n, sb / n);
    // Sample (n - 1) covariance, as in the reference implementation with a uniform window.
    let unbiased = n / (n - 1.0);
    let (va, vb) = (
        (saa / n - ma * ma) * unbiased,
        (sbb / n - mb * mb) * unbiased,
    );
    let covariance = (sab / n - ma * mb) * unbiased;
    (2.0 * ma * mb + C1) * (2.0 * covariance + C2) / ((ma * ma + mb * mb + C1) * (va + vb + C2))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ssim_is_one_for_equal_images_and_falls_with_noise_and_respects_the_mask() {
        let (w, h) = (32, 24);
        let image: Vec<[f32; 3]> = (0..w * h)
            .map(|i| {
                [
                    (i % 7) as f32 / 7.0,
                    (i % 5) as f32 / 5.0,
                    (i / w) as f32 / h as f32,
                ]
            })
            .collect();
        let mut noisy = image.clone();
        for (i, pixel) in noisy.iter_mut().enumerate().take(w * h / 2) {
            pixel[0] += if i % 2 == 0 { 0.2 } else { -0.2 };
        }
        let everywhere = vec![true; w * h];
        let clean: Vec<bool> = (0..w * h).map(|i| i >= w * h / 2).collect();
        assert!((ssim(w, h, &image, &image, &everywhere).unwrap() - 1.0).abs() < 1e-9);
        assert!(ssim(w, h, &image, &noisy, &everywhere).unwrap() < 0.97);
        assert!((ssim(w, h, &image, &noisy, &clean).unwrap() - 1.0).abs() < 1e-9);
        assert!(ssim(w, h, &image, &noisy, &vec![false; w * h]).is_none());
    }

    #[test]
    fn psnr_of_a_tenth() {
        assert!((psnr_db(0.01) - 20.0).abs() < 1e-9);
    }
}
