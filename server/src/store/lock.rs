//! One server a data directory.

use std::fs::{File, OpenOptions, TryLockError};
use std::path::Path;

use super::error::{Error, IoContext, Result};

/// Name of the lock file in the data directory.
pub(super) const LOCK: &str = "LOCK";

/// Held for as long as the store is open; the kernel releases it when the process ends, however it ends.
#[derive(Debug)]
pub(super) struct DirectoryLock {
    _file: File,
}

impl DirectoryLock {
    pub(super) fn take(folder: &Path) -> Result<Self> {
        let path = folder.join(LOCK);
        let file = OpenOptions::new()
            .create(true)
            .truncate(false)
            .write(true)
            .open(&path)
            .at("open", &path)?;
        match file.try_lock() {
            Ok(()) => Ok(Self { _file: file }),
            Err(TryLockError::WouldBlock) => Err(Error::InUse {
                path: folder.to_owned(),
            }),
            Err(TryLockError::Error(source)) => Err(source).at("lock", path),
        }
    }
}
