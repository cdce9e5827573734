//! Files of a drive folder.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

use crate::read_log::{Error, Result, blob_ref};
use backlot_proto::v1;

/// Bytes of one Velodyne point: four little-endian f32.
const POINT_BYTES: usize = 16;

/// Lists `<folder>/<frame number>.<extension>` files by frame number; empty if the folder is missing.
pub(super) fn frame_files(folder: &Path, extensions: &[&str]) -> Result<BTreeMap<u32, PathBuf>> {
    let mut files = BTreeMap::new();
    if !folder.exists() {
        return Ok(files);
    }
    let entries = std::fs::read_dir(folder).map_err(|e| Error::io(folder, e, ""))?;
    for entry in entries {
        let path = entry.map_err(|e| Error::io(folder, e, ""))?.path();
        let extension = path.extension().and_then(|e| e.to_str()).unwrap_or("");
        if !extensions.iter().any(|e| extension.eq_ignore_ascii_case(e)) {
            continue;
        }
        let stem = path.file_stem().and_then(|s| s.to_str()).unwrap_or("");
        let frame = stem
            .parse()
            .map_err(|_| Error::malformed(&path, "the file name is not a frame number"))?;
        if let Some(other) = files.insert(frame, path.clone()) {
            let what = format!("frame {frame} is also {}", other.display());
            return Err(Error::malformed(&path, what));
        }
    }
    Ok(files)
}

/// Width and height of an image, from its header.
pub(super) fn image_size(path: &Path) -> Result<(u32, u32)> {
    let does_not_decode = |e| Error::malformed(path, format!("the image does not decode: {e}"));
    image::image_dimensions(path).map_err(does_not_decode)
}

/// Reads a sweep to its end and checks that it is whole points with finite positions.
pub(super) fn check_sweep(path: &Path) -> Result<v1::BlobRef> {
    let content = std::fs::read(path).map_err(|e| Error::io(path, e, ""))?;
    if content.len() % POINT_BYTES != 0 {
        let what = format!(
            "{} bytes are not a whole number of {POINT_BYTES}-byte points: the file is truncated",
            content.len()
        );
        return Err(Error::malformed(path, what));
    }
    for (i, point) in content.chunks_exact(POINT_BYTES).enumerate() {
        let value =
            |k: usize| f32::from_le_bytes(point[4 * k..4 * k + 4].try_into().expect("4 bytes"));
        if !(0..3).all(|k| value(k).is_finite()) {
            return Err(Error::malformed(path, format!("point {i} is not finite")));
        }
    }
    Ok(blob_ref(&content))
}

/// The first byte of a text file that is not white space.
pub(super) fn first_byte(path: &Path, hint: &str) -> Result<Option<u8>> {
    use std::io::Read;
    let file = File::open(path).map_err(|e| Error::io(path, e, hint))?;
    for byte in BufReader::new(file).bytes() {
        let byte = byte.map_err(|e| Error::io(path, e, hint))?;
        if !byte.is_ascii_whitespace() {
            return Ok(Some(byte));
        }
    }
    Ok(None)
}
