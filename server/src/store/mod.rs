//! Everything that is kept: metadata and blobs of one data directory. The only module that knows sled or file names.
//!
//! Write order everywhere: blobs first, fsynced; then one metadata transaction that names them, fsynced; then the reply.
//! So a crash leaves the old state or the new one, and at worst blobs that nothing names.

mod error;
mod lock;
mod space;

mod record;

mod txn;

mod journal;

mod index;

mod committer;

mod metadata;

mod upload;

mod blobs;
#[cfg(test)]
mod blobs_tests;

mod library;

#[cfg(test)]
mod kill_tests;
mod logs;

mod jobs;

mod decompositions;

use std::path::{Path, PathBuf};
use std::sync::Arc;

pub use blobs::{Begun, BlobStore, MAX_BLOB_BYTES};
pub use decompositions::DecompositionRecord;
pub use error::{Error, Result};
pub use library::Library;
pub use logs::DriveLogRecord;
pub use metadata::Metadata;
pub use record::{Record, Stored};
pub use txn::Txn;
pub use upload::Upload;

use error::IoContext;

/// Where and how data is kept.
#[derive(Clone, Debug)]
pub struct StoreConfig {
    pub data_dir: PathBuf,
    /// Blob writes are refused while less than this is free.
    pub low_water_bytes: u64,
    /// Size of the file that is given back when the disk is full at start.
    pub ballast_bytes: u64,
}

/// The open store of one data directory; clones share it.
#[derive(Clone, Debug)]
pub struct Store {
    metadata: Arc<dyn Metadata>,
    blobs: BlobStore,
    _lock: Arc<lock::DirectoryLock>,
}

impl Store {
    /// Locks, migrates and opens the data directory, repairing what a crash left. Blocks.
    pub fn open(config: &StoreConfig) -> Result<Self> {
        let folder: &Path = &config.data_dir;
        std::fs::create_dir_all(folder).at("create", folder)?;
        let lock = lock::DirectoryLock::take(folder)?;
        backlot_migrations::migrate(folder, &[lock::LOCK])?;
        let space = space::Space::new(folder, config.low_water_bytes);
        space.release_ballast_if_full()?;
        let metadata = committer::JournaledIndex::open(&folder.join("metadata"), space.clone())?;
        let blobs = BlobStore::open(folder, space.clone())?;
        space.lay_ballast(config.ballast_bytes)?;
        Ok(Self {
            metadata: Arc::new(metadata),
            blobs,
            _lock: Arc::new(lock),
        })
    }

    pub fn metadata(&self) -> &dyn Metadata {
        &*self.metadata
    }

    pub fn blobs(&self) -> &BlobStore {
        &self.blobs
    }
}
