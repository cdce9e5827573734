//! Drive logs as kept: the manifest is a blob, the record holds what a list shows.

use serde::{Deserialize, Serialize};

use super::error::{Error, Result};
use super::record::Record;
use super::{Store, Txn};
use crate::domain::blob::BlobRef;
use crate::domain::clock::UnixMs;
use crate::domain::ids::DriveLogId;

/// The record of a drive log.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DriveLogRecord {
    pub id: DriveLogId,
    /// The encoded `backlot.v1.DriveLog` without its output-only fields.
    pub manifest: BlobRef,
    pub dataset: String,
    pub synthetic: bool,
    pub camera_count: u32,
    pub frame_count: u32,
    pub sweep_count: u32,
    pub track_count: u32,
    /// Path length of the ego trajectory in metres.
    pub travel_m: f64,
    pub created_at: UnixMs,
}

impl Record for DriveLogRecord {
    const TABLE: u8 = b'l';
    const VERSION: u8 = 1;
    const NOUN: &'static str = "drive log";

    fn id(&self) -> String {
        self.id.as_str().to_owned()
    }
}

impl Store {
    /// Commits a drive log whose manifest blob is written. The same log again is returned as it was committed first;
    /// the same name with another manifest is an error.
    pub fn create_drive_log(&self, log: DriveLogRecord) -> Result<DriveLogRecord> {
        match self.metadata().commit(Txn::new().create(&log)?) {
            Ok(()) => Ok(log),
            Err(Error::Conflict { .. }) => {
                let present = self.drive_log(&log.id)?;
                if present.manifest != log.manifest {
                    return Err(Error::Exists {
                        what: log.id.to_string(),
                    });
                }
                Ok(present)
            }
            Err(e) => Err(e),
        }
    }

    pub fn drive_log(&self, id: &DriveLogId) -> Result<DriveLogRecord> {
        Ok(self.metadata().load(id.as_str())?.record)
    }

    /// Up to `limit` logs with ids greater than `after`.
    pub fn drive_logs(&self, after: &str, limit: usize) -> Result<Vec<DriveLogRecord>> {
        self.metadata().page_where(after, limit, |_| true)
    }

    /// Removes the record; assets that were trained from the log stay.
    pub fn delete_drive_log(&self, id: &DriveLogId) -> Result<()> {
        let present = self.metadata().load::<DriveLogRecord>(id.as_str())?;
        self.metadata().commit(Txn::new().remove(&present))
    }
}
