//! A log's blobs as a server reads them, of a log that is on none: for pictures, examples and tests.

use std::io;

use backlot_proto::v1;
use backlot_server::domain::blob::BlobRef;
use backlot_server::ingest::LogBlobs;
use bytes::Bytes;

use super::ReadLog;

impl LogBlobs for ReadLog {
    type Error = io::Error;

    fn size_bytes(&self, blob: &BlobRef) -> io::Result<Option<u64>> {
        Ok(Some(LogBlobs::read(self, blob)?.len() as u64))
    }

    fn read(&self, blob: &BlobRef) -> io::Result<Bytes> {
        self.read_blob(&v1::BlobRef {
            digest: blob.digest.to_string(),
            size_bytes: blob.size_bytes,
        })
    }
}
