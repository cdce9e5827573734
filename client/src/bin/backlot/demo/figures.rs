//! Figures recomputed from written PNGs.

use std::path::Path;

use anyhow::{Context, ensure};
use image::{GrayImage, ImageBuffer, Luma, RgbImage};

/// PSNR in dB of two written images over the pixels where `counted` (by row-major index) holds.
pub(crate) fn psnr_of_files(
    a: &Path,
    b: &Path,
    counted: impl Fn(usize) -> bool,
) -> anyhow::Result<f64> {
    let (a, b) = (read_rgb(a)?, read_rgb(b)?);
    ensure!(a.dimensions() == b.dimensions(), "images differ in size");
    Ok(backlot_client::generator::psnr(
        a.as_raw(),
        b.as_raw(),
        counted,
    ))
}

pub(crate) fn read_rgb(path: &Path) -> anyhow::Result<RgbImage> {
    let image = image::open(path).with_context(|| path.display().to_string())?;
    Ok(image.into_rgb8())
}

/// Which pixels of a written mask are set, row-major.
pub(crate) fn read_mask(path: &Path) -> anyhow::Result<Vec<bool>> {
    let image = image::open(path).with_context(|| path.display().to_string())?;
    Ok(image.into_luma8().pixels().map(|p| p.0[0] > 127).collect())
}

pub(crate) fn read_luma16(path: &Path) -> anyhow::Result<ImageBuffer<Luma<u16>, Vec<u16>>> {
    let image = image::open(path).with_context(|| path.display().to_string())?;
    Ok(image.into_luma16())
}

/// A mask as an 8-bit image, 255 where set.
pub(crate) fn mask_image(width: u32, height: u32, mask: &[bool]) -> GrayImage {
    GrayImage::from_fn(width, height, |x, y| {
        Luma([if mask[(y * width + x) as usize] {
            255
        } else {
            0
        }])
    })
}

/// Intersection over union of two masks; 1 if both are empty.
pub(crate) fn mask_iou(a: &[bool], b: &[bool]) -> f64 {
    let both = a.iter().zip(b).filter(|(a, b)| **a && **b).count();
    let either = a.iter().zip(b).filter(|(a, b)| **a || **b).count();
    if either == 0 {
        1.0
    } else {
        both as f64 / either as f64
    }
}

/// Mean of the finite values; `None` if there is none.
pub(crate) fn mean(values: impl IntoIterator<Item = f64>) -> Option<f64> {
    let finite: Vec<f64> = values.into_iter().filter(|v| v.is_finite()).collect();
    (!finite.is_empty()).then(|| finite.iter().sum::<f64>() / finite.len() as f64)
}

pub(crate) fn median(values: impl IntoIterator<Item = f64>) -> Option<f64> {
    let mut finite: Vec<f64> = values.into_iter().filter(|v| v.is_finite()).collect();
    finite.sort_by(f64::total_cmp);
    finite.get(finite.len() / 2).copied()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn overlap_counts_both_sides() {
        let a = [true, true, false, false];
        let b = [false, true, true, false];
        assert!((mask_iou(&a, &b) - 1.0 / 3.0).abs() < 1e-12);
        assert_eq!(mask_iou(&[false], &[false]), 1.0);
    }

    #[test]
    fn unmeasured_values_do_not_count() {
        assert_eq!(mean([1.0, f64::NAN, 3.0]), Some(2.0));
        assert_eq!(mean([f64::NAN]), None);
        assert_eq!(median([3.0, f64::INFINITY, 1.0, 2.0]), Some(2.0));
    }
}
