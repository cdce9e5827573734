//! The blobs of a log that was never uploaded.

use std::collections::BTreeMap;
use std::io;

use backlot_client::read_log::BlobSource;
use backlot_server::domain::blob::BlobRef;
use backlot_server::ingest::LogBlobs;
use bytes::Bytes;

/// By digest.
pub(crate) struct MemoryBlobs(pub(crate) BTreeMap<String, BlobSource>);

impl LogBlobs for MemoryBlobs {
    type Error = io::Error;

    fn size_bytes(&self, blob: &BlobRef) -> io::Result<Option<u64>> {
        Ok(Some(self.read(blob)?.len() as u64))
    }

    fn read(&self, blob: &BlobRef) -> io::Result<Bytes> {
        let source = self.0.get(&blob.digest.to_string());
        source.ok_or(io::ErrorKind::NotFound)?.read()
    }
}
