//! Decompositions of drive logs, found by the digest of all that they depend on.

use serde::{Deserialize, Serialize};

use super::Store;
use super::error::Result;
use super::record::{Record, Stored};
use crate::domain::blob::{BlobRef, Digest};
use crate::domain::clock::UnixMs;
use crate::domain::ids::{DriveLogId, JobId};

/// The record of a decomposition.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DecompositionRecord {
    /// `DecompositionInputs::digest`.
    pub inputs: Digest,
    pub drive_log: DriveLogId,
    /// The stored `Decomposition`.
    pub manifest: BlobRef,
    /// The job that made it.
    pub job: JobId,
    pub created_at: UnixMs,
}

impl Record for DecompositionRecord {
    const TABLE: u8 = b'd';
    const VERSION: u8 = 1;
    const NOUN: &'static str = "decomposition";

    fn id(&self) -> String {
        self.inputs.to_string()
    }
}

impl Store {
    /// The decomposition of these inputs, if there is one.
    pub fn decomposition(&self, inputs: &Digest) -> Result<Option<Stored<DecompositionRecord>>> {
        self.metadata().find(&inputs.to_string())
    }
}
