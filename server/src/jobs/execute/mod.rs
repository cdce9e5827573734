//! What a worker does with a leased job: read the log, decompose it, train, measure, and hand over the assets.
//!
//! Everything it reads and writes goes through the worker port; time, progress and cancellation go through the job's control.

mod budget;
mod control;
mod error;
mod gate;
mod quality;

mod labels;

mod background;
mod objects;

mod decompose;

use std::sync::Arc;

use super::worker_port::{JobControl, LeasedJob, Outcome, PortError, WorkerPort};
use super::workers::Execute;
use crate::domain::blob::BlobRef;
use crate::domain::drive_log::DriveLog;
use crate::domain::job::JobKind;
use crate::ingest::{LogBlobs, MaskMatching};
use crate::segment::Segmenter;
use bytes::Bytes;
use error::Error;

/// How a server finds out what masks show.
#[derive(Clone, Debug, Default)]
pub struct Masking {
    pub matching: MaskMatching,
    /// Finds masks where a log brings none.
    pub segmenter: Option<Arc<dyn Segmenter>>,
}

/// What workers run.
pub fn executor(masking: Masking) -> Execute {
    Arc::new(move |job, port, control| run(job, port, control, &masking))
}

/// Runs one job to its end; blocks, and returns early once `control.cancelled()`.
fn run(job: &LeasedJob, port: &dyn WorkerPort, control: &JobControl, masking: &Masking) -> Outcome {
    let work = || {
        control::report(control, 0.0, "decode", 0, 0, "reading the log");
        let manifest = port.read_blob(&job.manifest.digest)?;
        let log = DriveLog::from_manifest(&manifest)?;
        let labels = |log| labels::labels(job, log, port, control, masking);
        match job.spec.kind {
            JobKind::Decompose => decompose::run(job, &log, port, control, masking),
            JobKind::Background => {
                let (log, labels) = labels(log)?;
                background::run(job, &log, &labels, port, control)
            }
            JobKind::Objects => {
                let (log, labels) = labels(log)?;
                objects::run(job, &log, &labels, port, control)
            }
        }
    };
    work().map_err(|error: Error| error.into_failure())
}

/// The port as decomposition reads it.
struct PortBlobs<'a>(&'a dyn WorkerPort);

impl LogBlobs for PortBlobs<'_> {
    type Error = PortError;

    fn size_bytes(&self, blob: &BlobRef) -> Result<Option<u64>, PortError> {
        Ok(Some(self.read(blob)?.len() as u64))
    }

    fn read(&self, blob: &BlobRef) -> Result<Bytes, PortError> {
        self.0.read_blob(&blob.digest)
    }
}
