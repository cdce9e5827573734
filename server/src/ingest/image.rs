//! Decoding images and masks, with limits on what a file may make us allocate.

use std::io::Cursor;

use image::{ColorType, DynamicImage, ImageDecoder, ImageFormat, ImageReader, Limits};

use crate::error::ErrorKind;

/// A 16384 x 16384 RGB image; the largest camera that is accepted fits.
const MAX_DECODED_BYTES: u64 = 3 << 28;

/// Why an image cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum ImageError {
    #[error("is neither PNG nor JPEG")]
    Format,
    #[error("does not decode: {0}")]
    Decode(#[from] image::ImageError),
    #[error("does not decode: the JPEG is cut off")]
    Truncated,
    #[error("is {found:?}, not {expected}")]
    Colour {
        found: ColorType,
        expected: &'static str,
    },
    #[error("has the value {value}, which is no label")]
    Label { value: u8 },
    #[error("is {}x{}, differs from the camera's {}x{}", found.0, found.1, expected.0, expected.1)]
    Size {
        found: (u32, u32),
        expected: (u32, u32),
    },
}

impl ImageError {
    pub fn kind(&self) -> ErrorKind {
        ErrorKind::Invalid
    }
}

/// Decodes a PNG or JPEG of `size` pixels to sRGB bytes, row-major, `height * width * 3`.
///
/// # Errors
/// [`ImageError`] if the bytes are cut off, of another format or of another size. The size is checked before the body is decoded.
pub(crate) fn decode_rgb(bytes: &[u8], size: (u32, u32)) -> Result<Vec<u8>, ImageError> {
    Ok(decode(bytes, size)?.into_rgb8().into_raw())
}

/// Decodes an instance mask: 16-bit grey, row-major.
///
/// # Errors
/// As [`decode_rgb`], and if it is not 16-bit grey.
pub(crate) fn decode_instance_mask(bytes: &[u8], size: (u32, u32)) -> Result<Vec<u16>, ImageError> {
    decode_grey16(bytes, size)
}

/// Decodes a depth map to its units: 16-bit grey, row-major.
///
/// # Errors
/// As [`decode_rgb`], and if it is not 16-bit grey.
pub(crate) fn decode_depth_map(bytes: &[u8], size: (u32, u32)) -> Result<Vec<u16>, ImageError> {
    decode_grey16(bytes, size)
}

fn decode_grey16(bytes: &[u8], size: (u32, u32)) -> Result<Vec<u16>, ImageError> {
    match decode(bytes, size)? {
        DynamicImage::ImageLuma16(mask) => Ok(mask.into_raw()),
        other => Err(ImageError::Colour {
            found: other.color(),
            expected: "16-bit grey",
        }),
    }
}

/// Decodes a sky mask: 8-bit grey, row-major, 255 = sky.
///
/// # Errors
/// As [`decode_rgb`], and if it is not 8-bit grey.
pub(crate) fn decode_sky_mask(bytes: &[u8], size: (u32, u32)) -> Result<Vec<u8>, ImageError> {
    match decode(bytes, size)? {
        DynamicImage::ImageLuma8(mask) => Ok(mask.into_raw()),
        other => Err(ImageError::Colour {
            found: other.color(),
            expected: "8-bit grey",
        }),
    }
}

/// Decodes a PNG or JPEG of whatever size and returns its size in pixels: an image of that size passes [`decode_rgb`].
///
/// # Errors
/// As [`decode_rgb`], and if it is not of 8 bits, which only masks and depth maps are not.
pub(super) fn decoded_size(bytes: &[u8]) -> Result<(u32, u32), ImageError> {
    let decoder = open(bytes)?;
    let (size, found) = (decoder.dimensions(), decoder.color_type());
    if found.bytes_per_pixel() != found.channel_count() {
        let expected = "8 bits a channel";
        return Err(ImageError::Colour { found, expected });
    }
    DynamicImage::from_decoder(decoder)?;
    Ok(size)
}

fn decode(bytes: &[u8], size: (u32, u32)) -> Result<DynamicImage, ImageError> {
    let decoder = open(bytes)?;
    if decoder.dimensions() != size {
        return Err(ImageError::Size {
            found: decoder.dimensions(),
            expected: size,
        });
    }
    Ok(DynamicImage::from_decoder(decoder)?)
}

fn open(bytes: &[u8]) -> Result<impl ImageDecoder + '_, ImageError> {
    let mut reader = ImageReader::new(Cursor::new(bytes))
        .with_guessed_format()
        .map_err(image::ImageError::IoError)?;
    match reader.format() {
        Some(ImageFormat::Png) => {}
        Some(ImageFormat::Jpeg) => require_end_of_jpeg(bytes)?,
        _ => return Err(ImageError::Format),
    }
    let mut limits = Limits::default();
    limits.max_alloc = Some(MAX_DECODED_BYTES);
    reader.limits(limits);
    Ok(reader.into_decoder()?)
}

/// The decoder fills a cut-off JPEG with grey instead of failing; a whole one ends with its end-of-image marker, perhaps padded.
fn require_end_of_jpeg(bytes: &[u8]) -> Result<(), ImageError> {
    let end = bytes.iter().rposition(|&b| b != 0).map_or(0, |i| i + 1);
    if bytes[..end].ends_with(&[0xff, 0xd9]) {
        Ok(())
    } else {
        Err(ImageError::Truncated)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::{GrayImage, ImageBuffer, Luma, RgbImage};

    fn encoded(image: &DynamicImage, format: ImageFormat) -> Vec<u8> {
        let mut bytes = Cursor::new(Vec::new());
        image.write_to(&mut bytes, format).unwrap();
        bytes.into_inner()
    }

    fn street() -> DynamicImage {
        RgbImage::from_fn(40, 30, |x, y| {
            image::Rgb([x as u8 * 6, y as u8 * 8, (x * y) as u8])
        })
        .into()
    }

    #[test]
    fn whole_images_decode_and_cut_ones_do_not() {
        for format in [ImageFormat::Png, ImageFormat::Jpeg] {
            let bytes = encoded(&street(), format);
            assert_eq!(decode_rgb(&bytes, (40, 30)).unwrap().len(), 3600);
            for keep in [0, 10, bytes.len() / 2, bytes.len() - 20] {
                assert!(
                    decode_rgb(&bytes[..keep], (40, 30)).is_err(),
                    "{format:?} {keep}"
                );
            }
        }
    }

    #[test]
    fn another_size_is_named() {
        let error = decode_rgb(&encoded(&street(), ImageFormat::Png), (40, 31)).unwrap_err();
        assert_eq!(
            error.to_string(),
            "is 40x30, differs from the camera's 40x31"
        );
    }

    #[test]
    fn masks_keep_their_depth() {
        let mask: ImageBuffer<Luma<u16>, _> =
            ImageBuffer::from_fn(4, 2, |x, _| Luma([x as u16 * 700]));
        let bytes = encoded(&mask.into(), ImageFormat::Png);
        assert_eq!(decode_instance_mask(&bytes, (4, 2)).unwrap()[3], 2100);
        assert!(decode_sky_mask(&bytes, (4, 2)).is_err());
        let sky = encoded(&GrayImage::new(4, 2).into(), ImageFormat::Png);
        assert!(decode_instance_mask(&sky, (4, 2)).is_err());
        assert_eq!(decode_sky_mask(&sky, (4, 2)).unwrap(), [0; 8]);
    }
}
