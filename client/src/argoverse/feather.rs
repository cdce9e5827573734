//! Feather files (Arrow IPC) of flat columns, LZ4, Zstandard or not compressed.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use arrow_array::cast::AsArray;
use arrow_array::types::{
    ArrowPrimitiveType, Float16Type, Float32Type, Float64Type, Int8Type, Int16Type, Int32Type,
    Int64Type, UInt8Type, UInt16Type, UInt32Type, UInt64Type,
};
use arrow_array::{Array, ArrayRef, RecordBatch};
use arrow_buffer::Buffer;
use arrow_ipc::convert::try_fb_to_schema;
use arrow_ipc::reader::{FileDecoder, read_footer_length};
use arrow_ipc::{Block, root_as_footer, root_as_message};
use arrow_schema::{DataType, Schema};

use crate::read_log::contained::contained;
use crate::read_log::{Error, Result};

/// Largest file; a sweep has about 1 MB, the annotations of a log a few.
const MAX_FILE_BYTES: u64 = 256 << 20;
/// What the rows of a file may unpack to.
const MAX_UNPACKED_BYTES: u64 = 512 << 20;
const MAX_ROWS: i64 = 20_000_000;
/// Bytes after the footer: its length and the magic number.
const TRAILER_BYTES: usize = 10;

/// The wanted columns of a file.
#[derive(Debug)]
pub(super) struct Columns {
    path: PathBuf,
    batches: Vec<RecordBatch>,
}

impl Columns {
    /// Reads those columns; `hint` says what to do if the file is missing.
    pub(super) fn read(path: &Path, wanted: &[&str], hint: &str) -> Result<Self> {
        let size = std::fs::metadata(path)
            .map_err(|e| Error::io(path, e, hint))?
            .len();
        if size > MAX_FILE_BYTES {
            let what = format!("has {size} bytes, at most {MAX_FILE_BYTES} are accepted");
            return Err(Error::malformed(path, what));
        }
        let content = std::fs::read(path).map_err(|e| Error::io(path, e, hint))?;
        let batches = contained(|| decode(Buffer::from_vec(content), wanted))
            .map_err(|what| Error::malformed(path, what))?;
        Ok(Self {
            path: path.to_owned(),
            batches,
        })
    }

    /// Numbers of any type.
    pub(super) fn numbers(&self, column: &str) -> Result<Vec<f64>> {
        self.collect(column, |array, out| {
            match array.data_type() {
                DataType::Float16 => extend::<Float16Type>(array, out, f64::from),
                DataType::Float32 => extend::<Float32Type>(array, out, f64::from),
                DataType::Float64 => extend::<Float64Type>(array, out, |v| v),
                _ => {
                    let mut integers = Vec::new();
                    extend_integers(array, &mut integers)?;
                    out.extend(integers.into_iter().map(|v| v as f64));
                }
            }
            Ok(())
        })
    }

    /// Integers of any width.
    pub(super) fn integers(&self, column: &str) -> Result<Vec<i64>> {
        self.collect(column, extend_integers)
    }

    pub(super) fn texts(&self, column: &str) -> Result<Vec<String>> {
        self.collect(column, |array, out| {
            match array.data_type() {
                DataType::Utf8 => {
                    out.extend(array.as_string::<i32>().iter().flatten().map(str::to_owned))
                }
                DataType::LargeUtf8 => {
                    out.extend(array.as_string::<i64>().iter().flatten().map(str::to_owned))
                }
                other => return Err(format!("is of type {other}, not text")),
            }
            Ok(())
        })
    }

    /// An error about one row.
    pub(super) fn bad_row(&self, row: usize, what: impl std::fmt::Display) -> Error {
        Error::malformed(&self.path, format!("row {row}: {what}"))
    }

    fn collect<T>(
        &self,
        column: &str,
        extend: impl Fn(&ArrayRef, &mut Vec<T>) -> Result<(), String>,
    ) -> Result<Vec<T>> {
        let mut values = Vec::new();
        for batch in &self.batches {
            let array = batch.column_by_name(column);
            let array = array.expect("columns are checked when the file is read");
            let read = if array.null_count() > 0 {
                Err(format!("has {} missing values", array.null_count()))
            } else {
                extend(array, &mut values)
            };
            read.map_err(|what| Error::malformed(&self.path, format!("column {column} {what}")))?;
        }
        Ok(values)
    }
}

fn extend<T: ArrowPrimitiveType>(
    array: &ArrayRef,
    out: &mut Vec<f64>,
    widen: impl Fn(T::Native) -> f64,
) {
    out.extend(array.as_primitive::<T>().values().iter().map(|v| widen(*v)));
}

fn extend_integers(array: &ArrayRef, out: &mut Vec<i64>) -> Result<(), String> {
    fn widen<T: ArrowPrimitiveType<Native: TryInto<i64>>>(
        array: &ArrayRef,
        out: &mut Vec<i64>,
    ) -> Result<(), String> {
        for &value in array.as_primitive::<T>().values() {
            out.push(
                value
                    .try_into()
                    .map_err(|_| "has a value beyond 63 bits".to_owned())?,
            );
        }
        Ok(())
    }
    match array.data_type() {
        DataType::Int8 => widen::<Int8Type>(array, out),
        DataType::Int16 => widen::<Int16Type>(array, out),
        DataType::Int32 => widen::<Int32Type>(array, out),
        DataType::Int64 => widen::<Int64Type>(array, out),
        DataType::UInt8 => widen::<UInt8Type>(array, out),
        DataType::UInt16 => widen::<UInt16Type>(array, out),
        DataType::UInt32 => widen::<UInt32Type>(array, out),
        DataType::UInt64 => widen::<UInt64Type>(array, out),
        other => Err(format!("is of type {other}, not a number")),
    }
}

/// Decodes the wanted columns. Every length in the file is checked before anything is allocated from it.
fn decode(content: Buffer, wanted: &[&str]) -> Result<Vec<RecordBatch>, String> {
    let not_feather =
        || "is no complete Feather (Arrow) file: it is cut off or something else".to_owned();
    let trailer = content
        .len()
        .checked_sub(TRAILER_BYTES)
        .ok_or_else(not_feather)?;
    let trailer_bytes = content[trailer..].try_into().expect("ten bytes");
    let footer_bytes = read_footer_length(trailer_bytes).map_err(|_| not_feather())?;
    let footer = trailer.checked_sub(footer_bytes).ok_or_else(not_feather)?;
    let footer = root_as_footer(&content[footer..trailer])
        .map_err(|e| format!("has a damaged footer: {e}"))?;
    let schema = footer.schema().ok_or("has no schema")?;
    let schema = Arc::new(try_fb_to_schema(schema).map_err(|e| e.to_string())?);
    let projection = project(&schema, wanted)?;
    let decoder =
        FileDecoder::new(Arc::clone(&schema), footer.version()).with_projection(projection);
    let mut batches = Vec::new();
    let mut unpacked_bytes = 0;
    for block in footer.recordBatches().iter().flatten() {
        let bytes = block_bytes(&content, block)?;
        check_lengths(&bytes, block, &mut unpacked_bytes)?;
        let batch = decoder
            .read_record_batch(block, &bytes)
            .map_err(|e| e.to_string())?;
        batches.extend(batch);
    }
    Ok(batches)
}

fn project(schema: &Schema, wanted: &[&str]) -> Result<Vec<usize>, String> {
    let mut projection = Vec::new();
    for column in wanted {
        let index = schema
            .index_of(column)
            .map_err(|_| format!("has no column {column}"))?;
        if schema.field(index).data_type().is_nested() {
            return Err(format!("column {column} is nested"));
        }
        projection.push(index);
    }
    projection.sort_unstable();
    Ok(projection)
}

fn block_bytes(content: &Buffer, block: &Block) -> Result<Buffer, String> {
    let parts = (
        usize::try_from(block.offset()),
        usize::try_from(block.metaDataLength()),
        usize::try_from(block.bodyLength()),
    );
    let outside = || "has a block outside the file".to_owned();
    let (Ok(offset), Ok(metadata), Ok(body)) = parts else {
        return Err(outside());
    };
    let length = metadata.checked_add(body).ok_or_else(outside)?;
    let end = offset.checked_add(length).ok_or_else(outside)?;
    if metadata < 8 || end > content.len() {
        return Err(outside());
    }
    Ok(content.slice_with_length(offset, length))
}

/// Adds what the block unpacks to, and refuses it if that is too much for one file.
fn check_lengths(bytes: &Buffer, block: &Block, unpacked_bytes: &mut u64) -> Result<(), String> {
    let (metadata, body) = bytes.split_at(block.metaDataLength() as usize);
    // Since format V5 a marker of four 0xff stands before the length.
    let skip = if metadata.starts_with(&[0xff; 4]) {
        8
    } else {
        4
    };
    let message =
        root_as_message(&metadata[skip..]).map_err(|e| format!("has a damaged block: {e}"))?;
    let batch = message
        .header_as_record_batch()
        .ok_or("has a block that is no batch of rows")?;
    if !(0..=MAX_ROWS).contains(&batch.length()) {
        return Err(format!(
            "has {} rows, at most {MAX_ROWS} are accepted",
            batch.length()
        ));
    }
    for buffer in batch.buffers().iter().flatten() {
        let range = usize::try_from(buffer.offset())
            .ok()
            .zip(usize::try_from(buffer.length()).ok());
        let end = range.and_then(|(offset, length)| offset.checked_add(length));
        let (Some((offset, length)), Some(end)) = (range, end) else {
            return Err("has a column outside its block".to_owned());
        };
        let packed = body
            .get(offset..end)
            .ok_or("has a column outside its block")?;
        let declared = packed
            .first_chunk::<8>()
            .map(|prefix| i64::from_le_bytes(*prefix));
        let unpacked = match (batch.compression(), declared) {
            (Some(_), Some(declared)) if declared > 0 => declared as u64,
            _ => length as u64,
        };
        *unpacked_bytes = unpacked_bytes.saturating_add(unpacked);
    }
    if *unpacked_bytes > MAX_UNPACKED_BYTES {
        return Err(format!(
            "unpacks to {unpacked_bytes} bytes, at most {MAX_UNPACKED_BYTES} are accepted"
        ));
    }
    Ok(())
}
