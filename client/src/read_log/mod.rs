//! What every reader returns: a manifest and where the bytes of its blobs are; and what the readers share.

mod error;

mod spool;

mod log_blobs;

pub(crate) mod choice;
pub(crate) mod contained;
pub(crate) mod content;
pub(crate) mod observations;
pub(crate) mod trajectory;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use backlot_proto::v1;
use bytes::Bytes;
use rayon::prelude::*;

pub use error::{Error, Result};
pub use spool::{Spool, SpoolWriter};

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
    /// Bytes converted from another form, kept on disk: logs are larger than memory.
    Spooled {
        spool: Arc<Spool>,
        offset: u64,
        size_bytes: u64,
    },
}

impl BlobSource {
    /// The blob's bytes. Blocks.
    ///
    /// # Errors
    /// Those of reading the file.
    pub fn read(&self) -> std::io::Result<Bytes> {
        match self {
            Self::File(path) => Ok(std::fs::read(path)?.into()),
            Self::Memory(content) => Ok(content.clone()),
            Self::Spooled {
                spool,
                offset,
                size_bytes,
            } => spool.read(*offset, *size_bytes),
        }
    }

    /// Names the source in messages.
    pub fn describe(&self, digest: &str) -> String {
        match self {
            Self::File(path) => path.display().to_string(),
            Self::Memory(_) | Self::Spooled { .. } => format!("blob {digest}"),
        }
    }
}

impl ReadLog {
    /// Adds bytes made in memory and returns the reference for the manifest.
    pub fn add_bytes(&mut self, content: impl Into<Bytes>) -> v1::BlobRef {
        let content = content.into();
        let blob = blob_ref(&content);
        self.blobs
            .insert(blob.digest.clone(), BlobSource::Memory(content));
        blob
    }

    /// Adds a file that was read as `blob`.
    pub(crate) fn add_file(&mut self, path: &Path, blob: &v1::BlobRef) {
        self.blobs
            .insert(blob.digest.clone(), BlobSource::File(path.to_owned()));
    }

    /// Adds bytes converted from another form; the same bytes are kept once.
    pub(crate) fn add_spooled(
        &mut self,
        spool: &mut SpoolWriter,
        content: &[u8],
    ) -> std::io::Result<v1::BlobRef> {
        let blob = blob_ref(content);
        if !self.blobs.contains_key(&blob.digest) {
            let source = spool.append(content)?;
            self.blobs.insert(blob.digest.clone(), source);
        }
        Ok(blob)
    }

    /// Forgets the sweeps, and says so in the notes.
    pub fn leave_lidar_out(&mut self) {
        let sweeps = std::mem::take(&mut self.drive_log.sweeps);
        for blob in sweeps.iter().filter_map(|sweep| sweep.points.as_ref()) {
            self.blobs.remove(&blob.digest);
        }
        let note = format!("{} LiDAR sweeps were left out", sweeps.len());
        self.drive_log.notes.push(note);
    }

    /// Decodes every camera image whole, which the readers leave to the server. Blocks for about 50 ms an image and thread.
    ///
    /// # Errors
    /// The first image that cannot be read or does not decode, by its file, camera and frame.
    pub fn check_images(&self) -> Result<()> {
        let sizes: BTreeMap<&str, (u32, u32)> = self
            .drive_log
            .cameras
            .iter()
            .map(|camera| (camera.camera_id.as_str(), (camera.width, camera.height)))
            .collect();
        self.drive_log.frames.par_iter().try_for_each(|frame| {
            let (Some(blob), Some(&size)) = (&frame.image, sizes.get(frame.camera_id.as_str()))
            else {
                return Ok(());
            };
            let content = self.read_blob(blob);
            let path = self.source_path(blob);
            let content = content.map_err(|e| Error::io(&path, e, ""))?;
            let checked = content::decode_image(&content, size, "the camera").map(drop);
            checked.map_err(|what| {
                let who = format!("camera {}, frame {}", frame.camera_id, frame.frame_index);
                Error::malformed(&path, format!("({who}) {what}"))
            })
        })
    }

    /// The file of a blob of the manifest, or what else names it.
    fn source_path(&self, blob: &v1::BlobRef) -> PathBuf {
        let source = self.blobs.get(&blob.digest);
        source.map_or_else(PathBuf::new, |s| s.describe(&blob.digest).into())
    }

    /// The bytes of a blob of the manifest. Blocks.
    ///
    /// # Errors
    /// Those of reading, and `NotFound` for a blob that is not the log's.
    pub fn read_blob(&self, blob: &v1::BlobRef) -> std::io::Result<Bytes> {
        let source = self.blobs.get(&blob.digest).ok_or_else(|| {
            let what = format!("blob {} is not of this log", blob.digest);
            std::io::Error::new(std::io::ErrorKind::NotFound, what)
        })?;
        source.read()
    }
}

/// The reference to a blob of this content.
pub(crate) fn blob_ref(content: &[u8]) -> v1::BlobRef {
    v1::BlobRef {
        digest: blake3::hash(content).to_hex().to_string(),
        size_bytes: content.len() as u64,
    }
}
