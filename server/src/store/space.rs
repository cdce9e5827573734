//! Free space: writes stop while there is still room to record that they stopped.

use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};

use super::error::{Error, IoContext, Result};

/// Metadata may go on until only this part of the low-water mark is free: jobs must be able to end on a full disk.
const METADATA_SHARE: u64 = 4;

/// The low-water mark of the file system that holds the data directory.
#[derive(Clone, Debug)]
pub struct Space {
    folder: PathBuf,
    low_water_bytes: u64,
}

impl Space {
    pub fn new(folder: &Path, low_water_bytes: u64) -> Self {
        Self {
            folder: folder.to_owned(),
            low_water_bytes,
        }
    }

    /// Refuses a blob write of `bytes` that would go under the low-water mark.
    pub fn require_for_blob(&self, bytes: u64) -> Result<()> {
        self.require(self.low_water_bytes.saturating_add(bytes))
    }

    /// Refuses a metadata write once only the last reserve is left.
    pub fn require_for_metadata(&self) -> Result<()> {
        self.require(self.low_water_bytes / METADATA_SHARE)
    }

    fn require(&self, needed_bytes: u64) -> Result<()> {
        let free_bytes = self.free_bytes()?;
        if free_bytes < needed_bytes {
            return Err(Error::DiskFull {
                free_bytes,
                needed_bytes,
            });
        }
        Ok(())
    }

    fn free_bytes(&self) -> Result<u64> {
        fs4::available_space(&self.folder).at("measure free space of", &self.folder)
    }

    /// Before the store opens: on a full disk gives the ballast back, because opening the index writes.
    pub fn release_ballast_if_full(&self) -> Result<()> {
        let ballast = self.ballast();
        if ballast.exists() && self.require_for_metadata().is_err() {
            std::fs::remove_file(&ballast).at("remove", &ballast)?;
            tracing::warn!("the disk is full; gave the ballast file back to be able to start");
        }
        Ok(())
    }

    /// After the store opened: lays the ballast down again where there is room for it.
    pub fn lay_ballast(&self, bytes: u64) -> Result<()> {
        let ballast = self.ballast();
        let present = std::fs::metadata(&ballast).map_or(0, |found| found.len());
        if present >= bytes || self.require_for_blob(bytes).is_err() {
            return Ok(());
        }
        let write = || -> std::io::Result<()> {
            let mut file = File::create(&ballast)?;
            // Written, not merely sized, so that the blocks are really taken.
            let block = [0xb1_u8; 64 << 10];
            let mut left = bytes;
            while left > 0 {
                let count = left.min(block.len() as u64);
                file.write_all(&block[..count as usize])?;
                left -= count;
            }
            file.sync_all()
        };
        write().at("write", &ballast)
    }

    fn ballast(&self) -> PathBuf {
        self.folder.join("ballast")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn writes_stop_under_the_mark_and_metadata_last() {
        let folder = tempfile::tempdir().unwrap();
        let free = Space::new(folder.path(), 0).free_bytes().unwrap();
        let low = Space::new(folder.path(), free / 2);
        assert!(low.require_for_blob(1).is_ok());
        assert!(matches!(
            low.require_for_blob(free),
            Err(Error::DiskFull { .. })
        ));
        let high = Space::new(folder.path(), free * 2);
        assert!(high.require_for_blob(0).is_err());
        assert!(high.require_for_metadata().is_ok());
        assert!(
            Space::new(folder.path(), free * 8)
                .require_for_metadata()
                .is_err()
        );
    }

    #[test]
    fn ballast_is_laid_and_released() {
        let folder = tempfile::tempdir().unwrap();
        Space::new(folder.path(), 0).lay_ballast(100_000).unwrap();
        let ballast = folder.path().join("ballast");
        assert_eq!(std::fs::metadata(&ballast).unwrap().len(), 100_000);
        Space::new(folder.path(), 0)
            .release_ballast_if_full()
            .unwrap();
        assert!(ballast.exists());
        Space::new(folder.path(), u64::MAX)
            .release_ballast_if_full()
            .unwrap();
        assert!(!ballast.exists());
    }
}
