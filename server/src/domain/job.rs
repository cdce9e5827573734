//! A durable training job as a pure state machine: `apply(event, now)` gives the next record or says why there is none.
//!
//! The queue persists what `apply` returns. A worker proves that it still owns the job by the lease epoch, which grows at
//! every claim: an event that carries an older epoch changes nothing.

use std::collections::BTreeMap;
use std::time::Duration;

use serde::{Deserialize, Serialize};

use super::blob::BlobRef;
use super::clock::UnixMs;
use super::ids::{AssetId, DriveLogId, JobId};
use crate::error::ErrorKind;

/// A worker that is silent this long has lost its job. Six lost heartbeats are survivable.
pub const LEASE: Duration = Duration::from_secs(30);

/// Attempts after which a job that keeps failing is given up.
pub const MAX_ATTEMPTS: u32 = 3;

/// Processes that may die while they run a job before the job itself is blamed. It is more than the attempts, because a
/// process also dies for reasons that are not the job's.
pub const MAX_CRASHES: u32 = 5;

/// Wait before the second attempt; doubled for each further one.
pub const RETRY_DELAY: Duration = Duration::from_secs(2);

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum JobKind {
    /// One background of a drive log.
    Background,
    /// Every usable object of a drive log.
    Objects,
    /// Segmentation and decomposition alone, kept for later jobs.
    Decompose,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Budget {
    Quick,
    Standard,
    /// The constants of the paper.
    Paper,
}

/// What is to be trained.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct JobSpec {
    pub kind: JobKind,
    pub drive_log: DriveLogId,
    pub budget: Budget,
    pub seed: u64,
    /// Every n-th frame is held out of training; at least 2.
    pub hold_out_every: u32,
}

#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Progress {
    /// 0..1.
    pub fraction: f64,
    /// E.g. "decode", "seed", "train", "evaluate", "publish".
    pub stage: String,
    pub step: u64,
    pub step_count: u64,
    /// One line for people.
    pub message: String,
}

/// Why an attempt ended without a result.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Failure {
    /// Machine-readable, UPPER_SNAKE_CASE, e.g. "DIVERGED", "BAD_INPUT".
    pub reason: String,
    pub message: String,
    /// Another attempt with the same input may succeed.
    pub retryable: bool,
}

/// What decomposition did with one track.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct TrackDecision {
    pub track_id: String,
    pub kept: bool,
    pub usable_frames: u32,
    pub rejected_frames: u32,
    pub rejected_by_reason: BTreeMap<String, u32>,
    /// Why the track was not kept; empty if it was.
    pub reason: String,
    pub moving: bool,
}

/// What a finished job has to say besides its assets; stored as a blob, since a log may have many tracks.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct JobReport {
    pub warnings: Vec<String>,
    pub tracks: Vec<TrackDecision>,
    /// What became of masks that were not tied to a track: count per outcome.
    #[serde(default)]
    pub free_masks: BTreeMap<String, u32>,
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum JobState {
    Queued { not_before: UnixMs },
    Running { worker: String, lease_ends: UnixMs },
    Succeeded,
    Failed { failure: Failure },
    Cancelled,
}

/// The record of a job.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Job {
    pub id: JobId,
    pub spec: JobSpec,
    pub state: JobState,
    /// Grows at each event.
    pub revision: u64,
    /// Grows at each claim.
    pub epoch: u64,
    /// Attempts begun, without those that ended with their process.
    pub attempt: u32,
    /// Processes that died while they ran this job.
    pub crashes: u32,
    pub cancel_requested: bool,
    pub progress: Progress,
    pub assets: Vec<AssetId>,
    pub report: Option<BlobRef>,
    pub created_at: UnixMs,
    pub started_at: Option<UnixMs>,
    pub ended_at: Option<UnixMs>,
}

/// What happens to a job.
#[derive(Clone, Debug, PartialEq)]
pub enum Event {
    Claimed {
        worker: String,
    },
    Heartbeat {
        epoch: u64,
        progress: Progress,
    },
    Completed {
        epoch: u64,
        assets: Vec<AssetId>,
        report: Option<BlobRef>,
    },
    Failed {
        epoch: u64,
        failure: Failure,
    },
    /// The worker stopped because it was told to.
    Stopped {
        epoch: u64,
    },
    /// The server is shutting down: the attempt is given back uncounted.
    Released {
        epoch: u64,
    },
    CancelRequested,
    /// No heartbeat came in time.
    LeaseExpired,
    /// Found running at start: its process is dead.
    ProcessDied,
}

/// Why an event does not apply.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Rejected {
    #[error("the job has ended")]
    Ended,
    #[error("the job is not due")]
    NotDue,
    #[error("the job is already running")]
    AlreadyRunning,
    #[error("lease epoch {held} is stale, the present one is {present}")]
    StaleEpoch { held: u64, present: u64 },
    #[error("the job is not running")]
    NotRunning,
    #[error("the lease has not expired")]
    LeaseHolds,
}

impl Rejected {
    pub fn kind(&self) -> ErrorKind {
        match self {
            Self::Ended | Self::NotDue | Self::AlreadyRunning | Self::LeaseHolds => {
                ErrorKind::NotReady
            }
            Self::StaleEpoch { .. } | Self::NotRunning => ErrorKind::LeaseLost,
        }
    }
}

impl Job {
    pub fn new(id: JobId, spec: JobSpec, now: UnixMs) -> Self {
        Self {
            id,
            spec,
            state: JobState::Queued { not_before: now },
            revision: 0,
            epoch: 0,
            attempt: 0,
            crashes: 0,
            cancel_requested: false,
            progress: Progress::default(),
            assets: Vec::new(),
            report: None,
            created_at: now,
            started_at: None,
            ended_at: None,
        }
    }

    pub fn is_ended(&self) -> bool {
        !matches!(
            self.state,
            JobState::Queued { .. } | JobState::Running { .. }
        )
    }

    pub fn is_running(&self) -> bool {
        matches!(self.state, JobState::Running { .. })
    }

    pub fn is_queued(&self) -> bool {
        matches!(self.state, JobState::Queued { .. })
    }

    /// The job after `event` at `now`.
    pub fn apply(&self, event: Event, now: UnixMs) -> Result<Job, Rejected> {
        let mut next = self.clone();
        next.revision += 1;
        match event {
            Event::Claimed { worker } => next.claim(worker, now)?,
            Event::Heartbeat { epoch, progress } => {
                next.require_lease(epoch)?;
                next.progress = progress;
                next.extend_lease(now);
            }
            Event::Completed {
                epoch,
                assets,
                report,
            } => {
                next.require_lease(epoch)?;
                next.assets = assets;
                next.report = report;
                next.progress.fraction = 1.0;
                next.end(JobState::Succeeded, now);
            }
            Event::Failed { epoch, failure } => {
                next.require_lease(epoch)?;
                next.retry_or_fail(failure, now);
            }
            Event::Stopped { epoch } => {
                next.require_lease(epoch)?;
                next.end(JobState::Cancelled, now);
            }
            Event::Released { epoch } => {
                next.require_lease(epoch)?;
                next.attempt -= 1;
                next.requeue(now, now);
            }
            Event::CancelRequested => next.cancel(now)?,
            Event::LeaseExpired => next.expire(now)?,
            Event::ProcessDied => next.survive_crash(now)?,
        }
        Ok(next)
    }

    fn claim(&mut self, worker: String, now: UnixMs) -> Result<(), Rejected> {
        match self.state {
            JobState::Queued { not_before } if not_before <= now => {}
            JobState::Queued { .. } => return Err(Rejected::NotDue),
            JobState::Running { .. } => return Err(Rejected::AlreadyRunning),
            _ => return Err(Rejected::Ended),
        }
        self.epoch += 1;
        self.attempt += 1;
        self.progress = Progress::default();
        self.started_at = self.started_at.or(Some(now));
        self.state = JobState::Running {
            worker,
            lease_ends: now.plus(LEASE),
        };
        Ok(())
    }

    fn require_lease(&self, epoch: u64) -> Result<(), Rejected> {
        if self.epoch != epoch {
            return Err(Rejected::StaleEpoch {
                held: epoch,
                present: self.epoch,
            });
        }
        if self.is_running() {
            Ok(())
        } else {
            Err(Rejected::NotRunning)
        }
    }

    fn extend_lease(&mut self, now: UnixMs) {
        if let JobState::Running { lease_ends, .. } = &mut self.state {
            *lease_ends = now.plus(LEASE);
        }
    }

    fn cancel(&mut self, now: UnixMs) -> Result<(), Rejected> {
        if self.is_ended() {
            return Err(Rejected::Ended);
        }
        self.cancel_requested = true;
        if self.is_queued() {
            self.end(JobState::Cancelled, now);
        }
        Ok(())
    }

    fn expire(&mut self, now: UnixMs) -> Result<(), Rejected> {
        match self.state {
            JobState::Running { lease_ends, .. } if lease_ends <= now => {}
            JobState::Running { .. } => return Err(Rejected::LeaseHolds),
            _ => return Err(Rejected::NotRunning),
        }
        let message = format!("no heartbeat for {} s", LEASE.as_secs());
        self.retry_or_fail(retryable("LEASE_EXPIRED", message), now);
        Ok(())
    }

    fn survive_crash(&mut self, now: UnixMs) -> Result<(), Rejected> {
        if !self.is_running() {
            return Err(Rejected::NotRunning);
        }
        self.crashes += 1;
        self.attempt -= 1;
        if self.cancel_requested {
            self.end(JobState::Cancelled, now);
        } else if self.crashes >= MAX_CRASHES {
            let message = format!("{} processes died while they ran this job", self.crashes);
            let failure = Failure {
                retryable: false,
                ..retryable("POISONED", message)
            };
            self.end(JobState::Failed { failure }, now);
        } else {
            self.requeue(now, now);
        }
        Ok(())
    }

    fn retry_or_fail(&mut self, failure: Failure, now: UnixMs) {
        if self.cancel_requested {
            self.end(JobState::Cancelled, now);
        } else if failure.retryable && self.attempt < MAX_ATTEMPTS {
            let wait = RETRY_DELAY * 2u32.pow(self.attempt - 1);
            self.progress.message = format!("attempt {} failed: {}", self.attempt, failure.message);
            self.requeue(now.plus(wait), now);
        } else {
            self.end(JobState::Failed { failure }, now);
        }
    }

    fn requeue(&mut self, not_before: UnixMs, now: UnixMs) {
        if self.cancel_requested {
            self.end(JobState::Cancelled, now);
        } else {
            self.state = JobState::Queued { not_before };
        }
    }

    fn end(&mut self, state: JobState, now: UnixMs) {
        self.state = state;
        self.ended_at = Some(now);
    }
}

fn retryable(reason: &str, message: String) -> Failure {
    Failure {
        reason: reason.into(),
        message,
        retryable: true,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn job() -> Job {
        let spec = JobSpec {
            kind: JobKind::Background,
            drive_log: DriveLogId::new("street").unwrap(),
            budget: Budget::Quick,
            seed: 1,
            hold_out_every: 8,
        };
        Job::new(JobId::new("j1").unwrap(), spec, UnixMs(0))
    }

    fn claimed(job: &Job, now: UnixMs) -> Job {
        let worker = "w0".to_owned();
        job.apply(Event::Claimed { worker }, now).unwrap()
    }

    fn complete(epoch: u64) -> Event {
        Event::Completed {
            epoch,
            assets: Vec::new(),
            report: None,
        }
    }

    #[test]
    fn a_stale_epoch_changes_nothing() {
        let first = claimed(&job(), UnixMs(0));
        let expired = first.apply(Event::LeaseExpired, UnixMs(30_000)).unwrap();
        let second = claimed(&expired, UnixMs(60_000));
        assert_eq!(second.epoch, 2);
        assert_eq!(
            second.apply(complete(1), UnixMs(60_001)),
            Err(Rejected::StaleEpoch {
                held: 1,
                present: 2
            })
        );
        assert_eq!(
            second.apply(complete(2), UnixMs(60_001)).unwrap().state,
            JobState::Succeeded
        );
        // Between the claims nobody holds the lease either.
        assert_eq!(
            expired.apply(complete(1), UnixMs(30_001)),
            Err(Rejected::NotRunning)
        );
    }

    #[test]
    fn a_lease_expires_at_its_end_and_not_before() {
        let running = claimed(&job(), UnixMs(0));
        let early = running.apply(Event::LeaseExpired, UnixMs(29_999));
        assert_eq!(early, Err(Rejected::LeaseHolds));
        let heartbeat = Event::Heartbeat {
            epoch: 1,
            progress: Progress::default(),
        };
        let extended = running.apply(heartbeat, UnixMs(20_000)).unwrap();
        assert!(extended.apply(Event::LeaseExpired, UnixMs(49_999)).is_err());
        assert!(extended.apply(Event::LeaseExpired, UnixMs(50_000)).is_ok());
    }

    #[test]
    fn a_failing_job_is_given_up_after_three_attempts_with_growing_waits() {
        let mut job = job();
        let mut now = UnixMs(0);
        let mut waits = Vec::new();
        while let JobState::Queued { not_before } = job.state {
            waits.push(not_before.0 - now.0);
            now = not_before;
            let running = claimed(&job, now);
            let failure = retryable("DIVERGED", "loss".into());
            let epoch = running.epoch;
            job = running
                .apply(Event::Failed { epoch, failure }, now)
                .unwrap();
        }
        assert_eq!(waits, [0, 2_000, 4_000]);
        assert_eq!(job.attempt, MAX_ATTEMPTS);
        assert!(matches!(job.state, JobState::Failed { .. }));
        assert!(job.apply(Event::CancelRequested, now).is_err());
    }

    #[test]
    fn crashes_do_not_count_as_attempts_until_the_job_is_poison() {
        let mut job = job();
        for crash in 1..=MAX_CRASHES {
            assert_eq!(job.attempt, 0);
            job = claimed(&job, UnixMs(0));
            job = job.apply(Event::ProcessDied, UnixMs(0)).unwrap();
            assert_eq!(job.is_queued(), crash < MAX_CRASHES);
        }
        let JobState::Failed { failure } = &job.state else {
            panic!("{:?}", job.state)
        };
        assert_eq!(failure.reason, "POISONED");
    }

    #[test]
    fn cancelling_ends_a_queued_job_at_once_and_a_running_one_when_its_worker_stops() {
        let queued = job().apply(Event::CancelRequested, UnixMs(1)).unwrap();
        assert_eq!(queued.state, JobState::Cancelled);
        let running = claimed(&job(), UnixMs(0));
        let asked = running.apply(Event::CancelRequested, UnixMs(1)).unwrap();
        assert!(asked.is_running());
        for event in [
            Event::Stopped { epoch: 1 },
            Event::ProcessDied,
            Event::Released { epoch: 1 },
        ] {
            let ended = asked.apply(event, UnixMs(2)).unwrap();
            assert_eq!(ended.state, JobState::Cancelled);
            assert_eq!(ended.ended_at, Some(UnixMs(2)));
        }
    }
}
