//! Where a job's labels come from: an earlier decomposition of the same inputs, else made from the log.

use std::collections::BTreeMap;

use super::budget::LEAST_FRAMES;
use super::control::report;
use super::error::Error;
use super::{Masking, PortBlobs};
use crate::domain::drive_log::{CameraFrame, DriveLog};
use crate::domain::job::JobKind;
use crate::ingest::{
    ClassedMasks, DECOMPOSITION_VERSION, Decomposition, DecompositionInputs, LogLabels,
    MatchedMasks, Segmentation, StoredLabels, TiedMask, match_masks, segment_log, tie_masks,
};
use crate::jobs::worker_port::{JobControl, KnownDecomposition, LeasedJob, WorkerPort};
use crate::segment::Segmenter;

/// The labels of a job's log.
#[derive(Debug)]
pub(super) struct JobLabels {
    pub labels: LogLabels,
    /// What became of masks that named no track: count per outcome.
    pub free_masks: BTreeMap<String, u32>,
    /// Masks of frames in which the log names no tracks; only background jobs have them.
    pub tied_masks: Vec<TiedMask>,
    /// For people: whose labels are reused, or what was segmented.
    pub note: Option<String>,
}

impl JobLabels {
    /// A progress message that says whose labels are read.
    pub(super) fn while_decoding(&self, message: &str) -> String {
        let note = self.note.as_ref().map(|note| format!("; {note}"));
        format!("{message}{}", note.unwrap_or_default())
    }
}

/// Labels of an earlier decomposition if there is one, else what is needed to make them; and the log, with the segmenter's masks where
/// they were needed.
pub(super) fn labels(
    job: &LeasedJob,
    log: DriveLog,
    port: &dyn WorkerPort,
    control: &JobControl,
    masking: &Masking,
) -> Result<(DriveLog, JobLabels), Error> {
    if let Some((known, stored)) = stored(&inputs(job, &log, masking), port)? {
        let labels = JobLabels {
            labels: LogLabels::Stored(StoredLabels::new(&stored)),
            free_masks: stored.free_masks,
            tied_masks: stored.tied_masks,
            note: Some(format!("reused the decomposition of {}", known.job)),
        };
        return Ok((log, labels));
    }
    let masked = masked(log, port, control, masking)?;
    let tied_masks = match job.spec.kind {
        JobKind::Background => tied(&masked, port, control)?,
        JobKind::Objects | JobKind::Decompose => Vec::new(),
    };
    let labels = JobLabels {
        free_masks: masked.masks.outcomes(),
        labels: LogLabels::Made(masked.masks),
        tied_masks,
        note: masked.segmentation.as_ref().map(Segmentation::summary),
    };
    Ok((masked.log, labels))
}

/// What a decomposition of the job's log depends on.
pub(super) fn inputs(job: &LeasedJob, log: &DriveLog, masking: &Masking) -> DecompositionInputs {
    DecompositionInputs {
        version: DECOMPOSITION_VERSION,
        manifest: job.manifest,
        matching: masking.matching,
        segmenter: segmenter(log, masking).map(|segmenter| segmenter.digest()),
        least_frames: LEAST_FRAMES as u32,
    }
}

/// The segmenter, if the log needs one.
fn segmenter<'a>(log: &DriveLog, masking: &'a Masking) -> Option<&'a dyn Segmenter> {
    let brings_none = |f: &CameraFrame| f.instance_mask.is_none() && f.free_instance_mask.is_none();
    let needed = log.frames.iter().any(brings_none);
    masking.segmenter.as_deref().filter(|_| needed)
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

/// A log and what its masks show.
#[derive(Debug)]
pub(super) struct MaskedLog {
    /// With the segmentation's masks.
    pub log: DriveLog,
    /// `None` if nothing had to be segmented.
    pub segmentation: Option<Segmentation>,
    pub masks: MatchedMasks,
}

/// Segments the frames without masks if there is a segmenter, and matches free masks to tracks.
pub(super) fn masked(
    log: DriveLog,
    port: &dyn WorkerPort,
    control: &JobControl,
    masking: &Masking,
) -> Result<MaskedLog, Error> {
    let blobs = PortBlobs(port);
    let segmentation = match segmenter(&log, masking) {
        None => None,
        Some(segmenter) => {
            let what = format!("finding road users with {}", segmenter.name());
            let progress = progress(control, "segment", &what);
            let write = |content: &[u8]| port.write_blob(content);
            let found = segment_log(&log, &blobs, segmenter, write, progress)?;
            Some(found.ok_or(Error::Cancelled)?)
        }
    };
    let log = match &segmentation {
        Some(segmentation) => segmentation.over(log),
        None => log,
    };
    let source = ClassedMasks {
        blobs: &blobs,
        segmentation: segmentation.as_ref(),
    };
    let progress = progress(control, "match", "matching masks to tracks");
    let masks = match_masks(&log, &blobs, &source, &masking.matching, progress)?;
    Ok(MaskedLog {
        masks: masks.ok_or(Error::Cancelled)?,
        segmentation,
        log,
    })
}

fn tied(
    masked: &MaskedLog,
    port: &dyn WorkerPort,
    control: &JobControl,
) -> Result<Vec<TiedMask>, Error> {
    let progress = progress(control, "match", "writing the tracks' masks");
    let write = |content: &[u8]| port.write_blob(content);
    let tied = tie_masks(
        &masked.log,
        &PortBlobs(port),
        &masked.masks,
        write,
        progress,
    )?;
    tied.ok_or(Error::Cancelled)
}

/// Reports a stage before training, and says whether to go on.
fn progress<'a>(
    control: &'a JobControl,
    stage: &'a str,
    what: &'a str,
) -> impl FnMut(usize, usize) -> bool + 'a {
    move |done, count| {
        report(control, 0.0, stage, done, count, what);
        !control.cancelled()
    }
}
