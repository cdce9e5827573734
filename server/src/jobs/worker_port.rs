//! All that a worker may touch. In-process workers use it too, so that workers can later move to other machines.

use std::sync::{Condvar, Mutex, MutexGuard, OnceLock};
use std::time::{Duration, Instant};

use bytes::Bytes;

use crate::domain::asset::NewAsset;
use crate::domain::blob::{BlobRef, Digest};
use crate::domain::ids::{DriveLogId, JobId};
use crate::domain::job::{Failure, JobReport, JobSpec, Progress};
use crate::error::ErrorKind;

/// The right to work on a job until `epoch` is overtaken.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Lease {
    pub job: JobId,
    pub epoch: u64,
    pub attempt: u32,
}

/// A job and all that is needed to begin it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LeasedJob {
    pub lease: Lease,
    pub spec: JobSpec,
    pub drive_log: DriveLogId,
    /// The log, to be read with `DriveLog::from_manifest`.
    pub manifest: BlobRef,
}

/// What a worker must do after a heartbeat.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Directive {
    Continue,
    /// The job was cancelled: stop soon.
    Cancel,
    /// Another attempt owns the job: stop, nothing more can be published.
    Lost,
}

/// A decomposition that an earlier job left.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct KnownDecomposition {
    /// The job that made it.
    pub job: JobId,
    pub manifest: BlobRef,
}

/// A decomposition whose blobs were written through the port.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NewDecomposition {
    /// Digest of all that it depends on.
    pub inputs: Digest,
    pub manifest: BlobRef,
}

/// The result of a job. Payload blobs were written through the port before.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Completion {
    pub assets: Vec<NewAsset>,
    pub report: JobReport,
    /// Kept for later jobs.
    pub decomposition: Option<NewDecomposition>,
}

/// How the work on a job ended.
pub type Outcome = Result<Completion, Failure>;

/// Why the port refused.
#[derive(Debug, thiserror::Error)]
#[error("{message}")]
pub struct PortError {
    pub kind: ErrorKind,
    pub message: String,
}

/// The service as a worker sees it. Calls block; none is made on a tokio worker thread.
pub trait WorkerPort: Send + Sync {
    /// The next due job, if any.
    fn lease(&self, worker: &str) -> Result<Option<LeasedJob>, PortError>;

    /// Reports progress and extends the lease.
    fn heartbeat(&self, lease: &Lease, progress: &Progress) -> Result<Directive, PortError>;

    /// A blob's whole content, verified against its digest.
    fn read_blob(&self, digest: &Digest) -> Result<Bytes, PortError>;

    /// The decomposition of these inputs, if a job made one.
    fn decomposition(&self, inputs: &Digest) -> Result<Option<KnownDecomposition>, PortError>;

    /// Puts a blob on stable storage.
    fn write_blob(&self, content: &[u8]) -> Result<BlobRef, PortError>;

    /// Publishes the assets and the decomposition and ends the job in one transaction guarded by the epoch.
    fn complete(&self, lease: &Lease, completion: Completion) -> Result<(), PortError>;

    fn fail(&self, lease: &Lease, failure: Failure) -> Result<(), PortError>;

    /// Ends the job as cancelled.
    fn stopped(&self, lease: &Lease) -> Result<(), PortError>;

    /// Gives the job back uncounted, because this worker is shutting down.
    fn release(&self, lease: &Lease) -> Result<(), PortError>;
}

/// Why running work must stop.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StopCause {
    Cancelled,
    LeaseLost,
    ShuttingDown,
}

/// How running work tells its progress and learns that it must stop. Calls are cheap: a pulse thread talks to the port.
#[derive(Debug)]
pub struct JobControl {
    started: Instant,
    shown: Mutex<Shown>,
    /// Signalled when the stage changed or the work ended.
    due: Condvar,
    stop: OnceLock<StopCause>,
}

#[derive(Debug, Default)]
struct Shown {
    progress: Progress,
    is_new_stage: bool,
    ended: bool,
}

impl JobControl {
    pub fn new() -> Self {
        Self {
            started: Instant::now(),
            shown: Mutex::default(),
            due: Condvar::new(),
            stop: OnceLock::new(),
        }
    }

    /// Replaces the progress that watchers see; a new stage is sent on at once, the rest with the next heartbeat.
    pub fn report(&self, progress: Progress) {
        let mut shown = self.lock();
        shown.is_new_stage |= shown.progress.stage != progress.stage;
        shown.progress = progress;
        if shown.is_new_stage {
            self.due.notify_all();
        }
    }

    /// The latest progress.
    pub fn progress(&self) -> Progress {
        self.lock().progress.clone()
    }

    /// True once the job was cancelled, its lease lost or the server is shutting down.
    pub fn cancelled(&self) -> bool {
        self.stop.get().is_some()
    }

    /// Makes `cancelled` true for good; the first cause stands.
    pub fn stop(&self, cause: StopCause) {
        let _ = self.stop.set(cause);
    }

    pub fn stop_cause(&self) -> Option<StopCause> {
        self.stop.get().copied()
    }

    /// Seconds since the attempt began.
    pub fn elapsed_s(&self) -> f64 {
        self.started.elapsed().as_secs_f64()
    }

    /// Waits for a new stage, at most `pulse`; the progress to send, or `None` once the work has ended.
    pub(super) fn next_beat(&self, pulse: Duration) -> Option<Progress> {
        let (mut shown, _) = self
            .due
            .wait_timeout_while(self.lock(), pulse, |shown| {
                !shown.is_new_stage && !shown.ended
            })
            .expect("no panic while held");
        shown.is_new_stage = false;
        (!shown.ended).then(|| shown.progress.clone())
    }

    /// Ends the heartbeats.
    pub(super) fn end(&self) {
        self.lock().ended = true;
        self.due.notify_all();
    }

    fn lock(&self) -> MutexGuard<'_, Shown> {
        self.shown.lock().expect("no panic while held")
    }
}

impl Default for JobControl {
    fn default() -> Self {
        Self::new()
    }
}
