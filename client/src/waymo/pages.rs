//! What the pages of a Parquet column say they hold, checked before anything is unpacked: a few bytes may claim gigabytes.

use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use parquet::column::page::{Page, PageMetadata, PageReader};
use parquet::errors::{ParquetError, Result as ParquetResult};
use parquet::file::metadata::ColumnChunkMetaData;

/// What one page may unpack to. Arrow's writer puts up to 1024 images into a page.
const MAX_PAGE_BYTES: u64 = 1 << 30;
/// Values of one page: a range image of the largest scanner with its poses has a million.
const MAX_PAGE_VALUES: u64 = 8 << 20;
/// Values of the pages that are opened for one row.
pub(super) const MAX_ROW_VALUES: u64 = 16 << 20;
/// A page header carries statistics, which may hold two values of the column.
const HEADER_WINDOWS: [u64; 2] = [16 << 10, 4 << 20];

/// Walks over the page headers of a column chunk.
pub(super) fn check(file: &File, chunk: &ColumnChunkMetaData) -> Result<(), String> {
    let (start, length) = chunk.byte_range();
    let file_bytes = file.metadata().map_err(|e| e.to_string())?.len();
    let end = start.checked_add(length).filter(|&end| end <= file_bytes);
    let end = end.ok_or("lies outside the file")?;
    let mut at = start;
    while at < end {
        let (page, header_bytes) = header_at(file, at, end)?;
        if page.unpacked_bytes > MAX_PAGE_BYTES || page.values > MAX_PAGE_VALUES {
            return Err(format!(
                "has a page of {} values in {} bytes, at most {MAX_PAGE_VALUES} in {MAX_PAGE_BYTES} are accepted",
                page.values, page.unpacked_bytes
            ));
        }
        at = at + header_bytes + page.packed_bytes;
        if at > end {
            return Err("has a page that reaches past its end".to_owned());
        }
    }
    Ok(())
}

fn header_at(mut file: &File, at: u64, end: u64) -> Result<(PageSizes, u64), String> {
    for window in HEADER_WINDOWS {
        let mut bytes = Vec::new();
        file.seek(SeekFrom::Start(at)).map_err(|e| e.to_string())?;
        let read = file.take(window.min(end - at)).read_to_end(&mut bytes);
        read.map_err(|e| e.to_string())?;
        let mut thrift = Thrift {
            bytes: &bytes,
            at: 0,
        };
        if let Some(sizes) = thrift.page_header() {
            return Ok((sizes, thrift.at as u64));
        }
    }
    Err("has a damaged page header".to_owned())
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct PageSizes {
    unpacked_bytes: u64,
    packed_bytes: u64,
    values: u64,
}

/// A cursor over Thrift's compact protocol; `None` where the bytes end or are none.
struct Thrift<'a> {
    bytes: &'a [u8],
    at: usize,
}

/// Types of fields in the compact protocol.
mod kind {
    pub(super) const TRUE: u8 = 1;
    pub(super) const FALSE: u8 = 2;
    pub(super) const I8: u8 = 3;
    pub(super) const I64: u8 = 6;
    pub(super) const DOUBLE: u8 = 7;
    pub(super) const BINARY: u8 = 8;
    pub(super) const LIST: u8 = 9;
    pub(super) const SET: u8 = 10;
    pub(super) const STRUCT: u8 = 12;
}

/// Headers nest three deep.
const MAX_DEPTH: u32 = 8;

impl Thrift<'_> {
    /// `PageHeader` of parquet.thrift: fields 2 and 3 are the sizes, 5, 7 and 8 the headers by kind of page.
    fn page_header(&mut self) -> Option<PageSizes> {
        let mut sizes = PageSizes::default();
        let mut field = 0;
        while let Some(kind) = self.field(&mut field)? {
            match (field, kind) {
                (2, 5) => sizes.unpacked_bytes = u64::try_from(self.zigzag()?).ok()?,
                (3, 5) => sizes.packed_bytes = u64::try_from(self.zigzag()?).ok()?,
                (5 | 7 | 8, kind::STRUCT) => sizes.values = self.first_number()?,
                _ => self.skip(kind, MAX_DEPTH)?,
            }
        }
        Some(sizes)
    }

    /// Field 1, `num_values`, of a data or dictionary page's header.
    fn first_number(&mut self) -> Option<u64> {
        let mut values = 0;
        let mut field = 0;
        while let Some(kind) = self.field(&mut field)? {
            match (field, kind) {
                (1, 5) => values = u64::try_from(self.zigzag()?).ok()?,
                _ => self.skip(kind, MAX_DEPTH)?,
            }
        }
        Some(values)
    }

    /// The kind of the next field, whose id goes to `field`; `Some(None)` at the end of the struct.
    fn field(&mut self, field: &mut i64) -> Option<Option<u8>> {
        let byte = self.byte()?;
        if byte == 0 {
            return Some(None);
        }
        let delta = i64::from(byte >> 4);
        *field = if delta == 0 {
            self.zigzag()?
        } else {
            field.checked_add(delta)?
        };
        Some(Some(byte & 15))
    }

    fn skip(&mut self, kind: u8, depth: u32) -> Option<()> {
        let depth = depth.checked_sub(1)?;
        match kind {
            kind::TRUE | kind::FALSE => {}
            kind::I8 => self.advance(1)?,
            4..=kind::I64 => {
                self.varint()?;
            }
            kind::DOUBLE => self.advance(8)?,
            kind::BINARY => {
                let length = usize::try_from(self.varint()?).ok()?;
                self.advance(length)?;
            }
            kind::LIST | kind::SET => {
                let head = self.byte()?;
                let count = if head >> 4 == 15 {
                    self.varint()?
                } else {
                    u64::from(head >> 4)
                };
                // Booleans take a byte each in lists.
                let element = if head & 15 <= kind::FALSE {
                    kind::I8
                } else {
                    head & 15
                };
                for _ in 0..count {
                    self.skip(element, depth)?;
                }
            }
            kind::STRUCT => {
                let mut field = 0;
                while let Some(kind) = self.field(&mut field)? {
                    self.skip(kind, depth)?;
                }
            }
            // Maps are in no page header.
            _ => return None,
        }
        Some(())
    }

    fn byte(&mut self) -> Option<u8> {
        let byte = *self.bytes.get(self.at)?;
        self.at += 1;
        Some(byte)
    }

    fn advance(&mut self, count: usize) -> Option<()> {
        self.at = self
            .at
            .checked_add(count)
            .filter(|&at| at <= self.bytes.len())?;
        Some(())
    }

    fn varint(&mut self) -> Option<u64> {
        let mut value = 0;
        for shift in (0..64).step_by(7) {
            let byte = self.byte()?;
            value |= u64::from(byte & 0x7f) << shift;
            if byte < 0x80 {
                return Some(value);
            }
        }
        None
    }

    fn zigzag(&mut self) -> Option<i64> {
        let value = self.varint()?;
        Some((value >> 1) as i64 ^ -((value & 1) as i64))
    }
}

/// Pages of a column that end with an error where one row opens too many values of them.
pub(super) struct BudgetedPages {
    pub inner: Box<dyn PageReader>,
    /// Values that may still be opened; set again before each row.
    pub budget: Arc<AtomicU64>,
}

impl Iterator for BudgetedPages {
    type Item = ParquetResult<Page>;

    fn next(&mut self) -> Option<Self::Item> {
        self.get_next_page().transpose()
    }
}

impl PageReader for BudgetedPages {
    fn get_next_page(&mut self) -> ParquetResult<Option<Page>> {
        let page = self.inner.get_next_page()?;
        let values = page.as_ref().map_or(0, |page| u64::from(page.num_values()));
        let left = self.budget.load(Ordering::Relaxed);
        let Some(left) = left.checked_sub(values) else {
            let what = format!("a row has more than {MAX_ROW_VALUES} values");
            return Err(ParquetError::General(what));
        };
        self.budget.store(left, Ordering::Relaxed);
        Ok(page)
    }

    fn peek_next_page(&mut self) -> ParquetResult<Option<PageMetadata>> {
        self.inner.peek_next_page()
    }

    fn skip_next_page(&mut self) -> ParquetResult<()> {
        self.inner.skip_next_page()
    }

    fn supports_deferred_dictionary(&self) -> bool {
        self.inner.supports_deferred_dictionary()
    }

    fn take_deferred_dictionary(&mut self) -> ParquetResult<Option<Page>> {
        self.inner.take_deferred_dictionary()
    }

    fn at_record_boundary(&mut self) -> ParquetResult<bool> {
        self.inner.at_record_boundary()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_are_read_past_fields_that_do_not_matter() {
        // type = 0, sizes 300 and 77, crc, data page header { 5 values, encoding, statistics { binary } }.
        let bytes = [
            0x15, 0x00, 0x15, 0xd8, 0x04, 0x15, 0x9a, 0x01, 0x15, 0x08, 0x1c, 0x15, 0x0a, 0x15,
            0x00, 0x3c, 0x18, 0x02, 0xaa, 0xbb, 0x00, 0x00, 0x00,
        ];
        let mut thrift = Thrift {
            bytes: &bytes,
            at: 0,
        };
        let expected = PageSizes {
            unpacked_bytes: 300,
            packed_bytes: 77,
            values: 5,
        };
        assert_eq!(thrift.page_header(), Some(expected));
        assert_eq!(thrift.at, bytes.len());
        for cut in 0..bytes.len() {
            let mut thrift = Thrift {
                bytes: &bytes[..cut],
                at: 0,
            };
            assert_eq!(thrift.page_header(), None, "cut at {cut}");
        }
    }
}
