//! Rendered planes as PNG.

use bytes::Bytes;
use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder};

use super::error::Result;
use super::sample::DEPTH_UNIT_M;

pub(super) fn rgb_png(rgb: &[u8], width: u32, height: u32) -> Result<Bytes> {
    png(rgb, width, height, ExtendedColorType::Rgb8)
}

pub(super) fn grey_png(grey: &[u8], width: u32, height: u32) -> Result<Bytes> {
    png(grey, width, height, ExtendedColorType::L8)
}

/// Instance ids, 16 bits.
pub(super) fn instance_png(instance: &[u16], width: u32, height: u32) -> Result<Bytes> {
    png(&native(instance), width, height, ExtendedColorType::L16)
}

/// Camera z in [`DEPTH_UNIT_M`], saturating; 0 = no surface.
pub(super) fn depth_png(depth_z_m: &[f32], width: u32, height: u32) -> Result<Bytes> {
    let units: Vec<u16> = depth_z_m
        .iter()
        .map(|&z| {
            if z > 0.0 {
                (f64::from(z) / DEPTH_UNIT_M)
                    .round()
                    .clamp(1.0, f64::from(u16::MAX)) as u16
            } else {
                0
            }
        })
        .collect();
    png(&native(&units), width, height, ExtendedColorType::L16)
}

/// The encoder takes 16-bit samples in native byte order.
fn native(values: &[u16]) -> Vec<u8> {
    values.iter().flat_map(|v| v.to_ne_bytes()).collect()
}

fn png(bytes: &[u8], width: u32, height: u32, color: ExtendedColorType) -> Result<Bytes> {
    let mut out = Vec::new();
    PngEncoder::new(&mut out).write_image(bytes, width, height, color)?;
    Ok(out.into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn depth_keeps_metres_and_marks_no_surface() {
        let png = depth_png(&[0.0, 1.0, 12.345, 1e6], 2, 2).unwrap();
        let image = image::load_from_memory(&png).unwrap().into_luma16();
        let values: Vec<u16> = image.into_raw();
        assert_eq!(values[..2], [0, 256]);
        assert!((f64::from(values[2]) * DEPTH_UNIT_M - 12.345).abs() < DEPTH_UNIT_M);
        assert_eq!(values[3], u16::MAX);
    }

    #[test]
    fn instance_ids_survive() {
        let png = instance_png(&[0, 1, 300, 65_535], 4, 1).unwrap();
        let image = image::load_from_memory(&png).unwrap().into_luma16();
        assert_eq!(image.into_raw(), [0, 1, 300, 65_535]);
    }
}
