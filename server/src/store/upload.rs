//! One blob being written: appended to at its committed offset, verified, then published.

use std::fs::{File, OpenOptions};
use std::io::{Seek, SeekFrom, Write};
use std::path::PathBuf;

use super::blobs::{BlobStore, digest_of_file};
use super::error::{Error, IoContext, Result};
use crate::domain::blob::BlobRef;

/// The only writer of its blob; dropping it keeps what was written for a later call.
#[derive(Debug)]
pub struct Upload {
    store: BlobStore,
    blob: BlobRef,
    path: PathBuf,
    file: File,
    committed_bytes: u64,
    /// Over what was written, if that is all there is: a resumed blob is read again at its end.
    hasher: Option<Box<blake3::Hasher>>,
}

impl Upload {
    pub(super) fn begin(store: BlobStore, blob: BlobRef, path: PathBuf) -> Result<Self> {
        if !store.reserve(blob.digest) {
            return Err(Error::BlobBusy {
                digest: blob.digest,
            });
        }
        open_at_end(&path, blob.size_bytes)
            .inspect_err(|_| store.unreserve(&blob.digest))
            .map(|(file, committed_bytes)| Self {
                store,
                blob,
                path,
                file,
                committed_bytes,
                hasher: (committed_bytes == 0).then(Box::default),
            })
    }

    /// Where the next chunk must start.
    pub fn committed_bytes(&self) -> u64 {
        self.committed_bytes
    }

    pub fn is_whole(&self) -> bool {
        self.committed_bytes == self.blob.size_bytes
    }

    /// Appends a chunk.
    pub fn write(&mut self, offset: u64, chunk: &[u8]) -> Result<()> {
        if offset != self.committed_bytes {
            return Err(Error::WrongOffset {
                digest: self.blob.digest,
                offset,
                committed_bytes: self.committed_bytes,
            });
        }
        let end = offset.saturating_add(chunk.len() as u64);
        if end > self.blob.size_bytes {
            return Err(Error::TooLarge {
                what: format!("content sent for blob {}", self.blob.digest),
                size_bytes: end,
                limit_bytes: self.blob.size_bytes,
            });
        }
        self.store.space().require_for_blob(chunk.len() as u64)?;
        if let Err(error) = self.file.write_all(chunk).at("write", &self.path) {
            // A part of the chunk may be there; the next one must start where this one did.
            let _ = self.file.set_len(self.committed_bytes);
            let _ = self.file.seek(SeekFrom::End(0));
            return Err(error);
        }
        if let Some(hasher) = &mut self.hasher {
            hasher.update(chunk);
        }
        self.committed_bytes = end;
        Ok(())
    }

    /// Makes what was written so far durable.
    pub fn sync(&self) -> Result<()> {
        self.file.sync_all().at("sync", &self.path)
    }

    /// Verifies the whole content and publishes it. Content that does not match its digest is removed.
    pub fn finish(self) -> Result<()> {
        self.sync()?;
        let found = match &self.hasher {
            Some(hasher) => hasher.finalize().into(),
            None => digest_of_file(&self.path)?,
        };
        if found != self.blob.digest || !self.is_whole() {
            std::fs::remove_file(&self.path).at("remove", &self.path)?;
            return Err(Error::Invalid {
                what: format!(
                    "the content sent for blob {} has digest {found} and {} of {} bytes; nothing was kept",
                    self.blob.digest, self.committed_bytes, self.blob.size_bytes
                ),
            });
        }
        self.store
            .publish(&self.blob.digest.to_string(), &self.blob.digest)
    }
}

impl Drop for Upload {
    fn drop(&mut self) {
        self.store.unreserve(&self.blob.digest);
    }
}

/// Opens the partial file behind what is already there. A file longer than the blob cannot be its beginning.
fn open_at_end(path: &PathBuf, size_bytes: u64) -> Result<(File, u64)> {
    let open = || -> std::io::Result<(File, u64)> {
        let mut file = OpenOptions::new()
            .create(true)
            .truncate(false)
            .write(true)
            .open(path)?;
        if file.metadata()?.len() > size_bytes {
            file.set_len(0)?;
        }
        let length = file.seek(SeekFrom::End(0))?;
        Ok((file, length))
    };
    open().at("open", path)
}
