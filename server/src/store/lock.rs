//! One server a data directory.

use std::fs::{File, OpenOptions, TryLockError};
use std::path::Path;
use std::time::{Duration, Instant};

use super::error::{Error, IoContext, Result};

/// Name of the lock file in the data directory.
pub(super) const LOCK: &str = "LOCK";

/// How long a lock may live on after its owner: a process that is just being started holds a copy of every open file of its
/// parent until it runs its own program, and an old server may still be ending.
pub(super) const LOCK_WAIT: Duration = Duration::from_secs(2);

const LOCK_POLL: Duration = Duration::from_millis(10);

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
        when_free(LOCK_WAIT, || match file.try_lock() {
            Ok(()) => Ok(()),
            Err(TryLockError::WouldBlock) => Err(Error::InUse {
                path: folder.to_owned(),
            }),
            Err(TryLockError::Error(source)) => Err(source).at("lock", path.clone()),
        })?;
        Ok(Self { _file: file })
    }
}

/// What `take` returns once it is not [`Error::InUse`], or that after `wait`.
pub(super) fn when_free<T>(wait: Duration, take: impl Fn() -> Result<T>) -> Result<T> {
    let start = Instant::now();
    loop {
        match take() {
            Err(Error::InUse { .. }) if start.elapsed() < wait => std::thread::sleep(LOCK_POLL),
            done => return done,
        }
    }
}
