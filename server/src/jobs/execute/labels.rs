//! Where a job's labels come from: an earlier decomposition of the same inputs, else made from the log.

use std::collections::BTreeMap;

use super::PortBlobs;
use super::budget::LEAST_FRAMES;
use super::control::report;
use super::error::Error;
use crate::domain::drive_log::DriveLog;
use crate::ingest::{
    DECOMPOSITION_VERSION, Decomposition, DecompositionInputs, LogLabels, LogMasks, MaskMatching,
    MatchedMasks, StoredLabels, match_masks,
};
use crate::jobs::worker_port::{JobControl, KnownDecomposition, LeasedJob, WorkerPort};

/// The labels of a job's log.
#[derive(Debug)]
pub(super) struct JobLabels {
    pub labels: LogLabels,
    /// What became of masks that named no track: count per outcome.
    pub free_masks: BTreeMap<String, u32>,
    /// For people: whose labels are reused.
    pub note: Option<String>,
}

impl JobLabels {
    /// A progress message that says whose labels are read.
    pub(super) fn while_decoding(&self, message: &str) -> String {
        let note = self.note.as_ref().map(|note| format!("; {note}"));
        format!("{message}{}", note.unwrap_or_default())
    }
}

/// Labels of an earlier decomposition if there is one, else what is needed to make them.
pub(super) fn labels(
    job: &LeasedJob,
    log: &DriveLog,
    port: &dyn WorkerPort,
    control: &JobControl,
    matching: &MaskMatching,
) -> Result<JobLabels, Error> {
    if let Some((known, stored)) = stored(&inputs(job, matching), port)? {
        return Ok(JobLabels {
            labels: LogLabels::Stored(StoredLabels::new(&stored)),
            free_masks: stored.free_masks,
            note: Some(format!("reused the decomposition of {}", known.job)),
        });
    }
    let masks = matched(log, port, control, matching)?;
    Ok(JobLabels {
        free_masks: masks.outcomes(),
        labels: LogLabels::Made(masks),
        note: None,
    })
}

/// What a decomposition of the job's log depends on.
pub(super) fn inputs(job: &LeasedJob, matching: &MaskMatching) -> DecompositionInputs {
    DecompositionInputs {
        version: DECOMPOSITION_VERSION,
        manifest: job.manifest,
        matching: *matching,
        least_frames: LEAST_FRAMES as u32,
    }
}

/// The stored decomposition of these inputs. One that cannot be read is as good as none: it is made again.
pub(super) fn stored(
    inputs: &DecompositionInputs,
    port: &dyn WorkerPort,
) -> Result<Option<(KnownDecomposition, Decomposition)>, Error> {
    let digest = inputs.digest();
    let Some(known) = port.decomposition(&digest)? else {
        return Ok(None);
    };
    let read = port.read_blob(&known.manifest.digest);
    let read = read.map_err(|error| error.to_string()).and_then(|bytes| {
        Decomposition::from_json(&bytes, &digest).map_err(|error| error.to_string())
    });
    Ok(match read {
        Ok(stored) => Some((known, stored)),
        Err(error) => {
            tracing::warn!(%error, job = %known.job, "a decomposition cannot be reused");
            None
        }
    })
}

/// Matches the log's free masks to its tracks.
pub(super) fn matched(
    log: &DriveLog,
    port: &dyn WorkerPort,
    control: &JobControl,
    matching: &MaskMatching,
) -> Result<MatchedMasks, Error> {
    let progress = |done: usize, count: usize| {
        let what = "matching masks to tracks";
        report(control, 0.0, "match", done, count, what);
        !control.cancelled()
    };
    let blobs = PortBlobs(port);
    match_masks(log, &LogMasks(&blobs), matching, progress)?.ok_or(Error::Cancelled)
}
