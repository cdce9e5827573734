//! Checks of what a log's files hold, shared by the readers.

use std::io::Cursor;
use std::path::Path;

use backlot_engine::camera::Rigid;
use backlot_proto::v1;
use glam::{DQuat, DVec3};
use image::{DynamicImage, ImageDecoder, ImageReader};

use super::{Error, Result, blob_ref};

/// Positions beyond this are damage: no map's coordinates are larger than the Earth.
const MAX_COORDINATE_M: f64 = 1e8;
/// Quaternions in files carry rounding, not more.
const MAX_NORM_ERROR: f64 = 1e-3;

/// Reads an image file to its end and checks it as [`check_header`] does; `source_of_size` says who wants that size.
pub(crate) fn check_image(
    path: &Path,
    size: (u32, u32),
    source_of_size: &str,
) -> Result<v1::BlobRef> {
    let content = std::fs::read(path).map_err(|e| Error::io(path, e, ""))?;
    check_header(&content, size, source_of_size).map_err(|what| Error::malformed(path, what))?;
    Ok(blob_ref(&content))
}

/// Checks that an image is not cut off and has `size` pixels. What lies between its ends is decoded by the server on arrival and by
/// [`ReadLog::check_images`](super::ReadLog::check_images): decoding costs three times the sending.
pub(crate) fn check_header(
    content: &[u8],
    size: (u32, u32),
    source_of_size: &str,
) -> Result<(), String> {
    open(content, size, source_of_size).map(drop)
}

/// Decodes an image of `size` pixels; the error says what is wrong with it.
pub(crate) fn decode_image(
    content: &[u8],
    size: (u32, u32),
    source_of_size: &str,
) -> Result<DynamicImage, String> {
    let decoder = open(content, size, source_of_size)?;
    DynamicImage::from_decoder(decoder).map_err(|e| format!("the image does not decode: {e}"))
}

fn open<'a>(
    content: &'a [u8],
    size: (u32, u32),
    source_of_size: &str,
) -> Result<impl ImageDecoder + 'a, String> {
    if content.is_empty() {
        return Err("the image is empty".to_owned());
    }
    let does_not_decode = |e: image::ImageError| format!("the image does not decode: {e}");
    let decoder = ImageReader::new(Cursor::new(content))
        .with_guessed_format()
        .map_err(|e| format!("the image does not decode: {e}"))?
        .into_decoder()
        .map_err(does_not_decode)?;
    let (width, height) = decoder.dimensions();
    if (width, height) != size {
        return Err(format!(
            "the image has {width}x{height} pixels, {source_of_size} says {}x{}",
            size.0, size.1
        ));
    }
    match cut_off(content) {
        Some(format) => Err(format!(
            "the image does not decode: the {format} is cut off"
        )),
        None => Ok(decoder),
    }
}

const JPEG_START: [u8; 2] = [0xff, 0xd8];
const JPEG_END: [u8; 2] = [0xff, 0xd9];
const PNG_START: [u8; 8] = *b"\x89PNG\r\n\x1a\n";
/// The empty IEND chunk with its checksum.
const PNG_END: [u8; 12] = *b"\0\0\0\0IEND\xae\x42\x60\x82";

/// The format of an image without its end marker, behind which there may be padding. Decoders fill a cut-off JPEG with grey.
fn cut_off(content: &[u8]) -> Option<&'static str> {
    let end = content.iter().rposition(|&b| b != 0).map_or(0, |i| i + 1);
    let content = &content[..end];
    let is_cut = |start: &[u8], end: &[u8]| content.starts_with(start) && !content.ends_with(end);
    if is_cut(&JPEG_START, &JPEG_END) {
        Some("JPEG")
    } else if is_cut(&PNG_START, &PNG_END) {
        Some("PNG")
    } else {
        None
    }
}

/// A rigid transform from numbers of a file; the error says which of them is unusable.
pub(crate) fn rigid(wxyz: [f64; 4], translation_m: [f64; 3]) -> Result<Rigid, String> {
    let [w, x, y, z] = wxyz;
    let rotation = DQuat::from_xyzw(x, y, z, w);
    let off = (rotation.length() - 1.0).abs();
    if off.is_nan() || off > MAX_NORM_ERROR {
        return Err(format!(
            "rotation (w, x, y, z) = {wxyz:?} is not a unit quaternion"
        ));
    }
    Ok(Rigid::new(rotation.normalize(), position(translation_m)?))
}

/// A position from numbers of a file.
pub(crate) fn position(xyz_m: [f64; 3]) -> Result<DVec3, String> {
    let position = DVec3::from_array(xyz_m);
    if position.is_finite() && position.abs().max_element() < MAX_COORDINATE_M {
        Ok(position)
    } else {
        Err(format!("position {xyz_m:?} is not a place in metres"))
    }
}

/// A time in nanoseconds from one counted in microseconds since 1970.
pub(crate) fn time_of_micros(micros: i64) -> Result<i64, String> {
    let ns = micros.checked_mul(1000).filter(|&ns| ns >= 0);
    ns.ok_or_else(|| format!("timestamp {micros} is not in microseconds since 1970"))
}

/// Appends a point of [`v1::PointFormat::XyziF32`].
pub(crate) fn push_point(points: &mut Vec<u8>, position_m: DVec3, intensity: f32) {
    for value in position_m
        .as_vec3()
        .to_array()
        .into_iter()
        .chain([intensity])
    {
        points.extend_from_slice(&value.to_le_bytes());
    }
}
