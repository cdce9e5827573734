//! Converted blobs on disk: an unnamed temporary file that goes when the log does.

use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::sync::{Arc, Mutex, PoisonError};

use bytes::Bytes;

use super::BlobSource;

/// Blobs one after the other in an unnamed file of the system's temporary folder.
#[derive(Debug)]
pub struct Spool {
    file: Mutex<File>,
}

impl Spool {
    pub(super) fn read(&self, offset: u64, size_bytes: u64) -> io::Result<Bytes> {
        let mut content = vec![0; size_bytes as usize];
        let mut file = self.file.lock().unwrap_or_else(PoisonError::into_inner);
        file.seek(SeekFrom::Start(offset))?;
        file.read_exact(&mut content)?;
        Ok(content.into())
    }
}

/// Fills a spool.
#[derive(Debug)]
pub struct SpoolWriter {
    spool: Arc<Spool>,
    end: u64,
}

impl SpoolWriter {
    /// An empty spool.
    ///
    /// # Errors
    /// Those of making a temporary file.
    pub fn new() -> io::Result<Self> {
        let file = Mutex::new(tempfile::tempfile()?);
        Ok(Self {
            spool: Arc::new(Spool { file }),
            end: 0,
        })
    }

    pub(super) fn append(&mut self, content: &[u8]) -> io::Result<BlobSource> {
        let mut file = self
            .spool
            .file
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        file.seek(SeekFrom::Start(self.end))?;
        file.write_all(content)?;
        let offset = self.end;
        self.end += content.len() as u64;
        Ok(BlobSource::Spooled {
            spool: Arc::clone(&self.spool),
            offset,
            size_bytes: content.len() as u64,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blobs_read_back_in_any_order() {
        let mut writer = SpoolWriter::new().unwrap();
        let sources = [&b"first"[..], b"", b"third"].map(|c| writer.append(c).unwrap());
        for (source, content) in sources.iter().zip(["first", "", "third"]).rev() {
            assert_eq!(source.read().unwrap(), content);
        }
    }
}
