//! What every reader returns: a manifest and where the bytes of its blobs are.

use std::collections::BTreeMap;
use std::path::PathBuf;

use backlot_proto::v1;
use bytes::Bytes;

/// A driving log read from a data set or generated, ready to upload.
#[derive(Debug, Default)]
pub struct ReadLog {
    /// The manifest; `name` may be empty until the upload names it.
    pub drive_log: v1::DriveLog,
    /// Where the content of each blob named by the manifest is, by digest.
    pub blobs: BTreeMap<String, BlobSource>,
}

/// Where a blob's bytes come from.
#[derive(Clone, Debug)]
pub enum BlobSource {
    /// A file whose whole content is the blob.
    File(PathBuf),
    /// Bytes made in memory.
    Memory(Bytes),
}

impl ReadLog {
    /// Adds bytes made in memory and returns the reference for the manifest.
    pub fn add_bytes(&mut self, content: impl Into<Bytes>) -> v1::BlobRef {
        let content = content.into();
        let blob = v1::BlobRef {
            digest: blake3::hash(&content).to_hex().to_string(),
            size_bytes: content.len() as u64,
        };
        self.blobs
            .insert(blob.digest.clone(), BlobSource::Memory(content));
        blob
    }
}
