//! The worker port for workers in the server's own process.

use std::collections::BTreeSet;
use std::fmt::Display;
use std::sync::Arc;
use std::time::Duration;

use bytes::Bytes;

use super::error::{Error, Result};
use super::queue::Queue;
use super::worker_port::{
    Completion, Directive, KnownDecomposition, Lease, LeasedJob, PortError, WorkerPort,
};
use crate::domain::asset::Asset;
use crate::domain::blob::{BlobRef, Digest};
use crate::domain::job::{Event, Failure, Job, JobReport, JobState, LEASE, Progress, Rejected};
use crate::error::{ErrorKind, Kinded};
use crate::store::{self, BlobStore, DecompositionRecord, Txn};

/// Progress between two commits is shown to watchers only: a crash loses at most this much of the progress bar.
const COMMIT_EVERY: Duration = Duration::from_secs(5);

/// Connects workers to the queue and the blobs of one store.
#[derive(Clone, Debug)]
pub struct LocalPort {
    queue: Arc<Queue>,
}

impl LocalPort {
    pub fn new(queue: Arc<Queue>) -> Self {
        Self { queue }
    }

    fn blobs(&self) -> &BlobStore {
        self.queue.store().blobs()
    }

    fn lease_next(&self, worker: &str) -> Result<Option<LeasedJob>> {
        while let Some(job) = self.queue.claim(worker)? {
            let lease = Lease {
                job: job.id.clone(),
                epoch: job.epoch,
                attempt: job.attempt,
            };
            match self.queue.store().drive_log(&job.spec.drive_log) {
                Ok(log) => {
                    return Ok(Some(LeasedJob {
                        lease,
                        drive_log: log.id,
                        manifest: log.manifest,
                        spec: job.spec,
                    }));
                }
                Err(e @ store::Error::NotFound { .. }) => {
                    let failure = Failure {
                        reason: "BAD_INPUT".into(),
                        message: e.to_string(),
                        retryable: false,
                    };
                    self.fail_lease(&lease, failure)?;
                }
                Err(e) => return Err(e.into()),
            }
        }
        Ok(None)
    }

    fn beat(&self, lease: &Lease, progress: &Progress) -> Result<Directive> {
        let job = self.queue.job(&lease.job)?;
        let directive = directive(&job, lease);
        if directive == Directive::Lost {
            return Ok(directive);
        }
        if !is_commit_due(&job, progress, self.queue.now()) {
            self.queue.feed().publish_progress(&job, progress);
            return Ok(directive);
        }
        let event = Event::Heartbeat {
            epoch: lease.epoch,
            progress: progress.clone(),
        };
        match self.queue.apply(&lease.job, event) {
            Ok(job) => Ok(self::directive(&job, lease)),
            Err(Error::Rejected {
                rejected: Rejected::StaleEpoch { .. } | Rejected::NotRunning,
                ..
            }) => Ok(Directive::Lost),
            Err(e) => Err(e),
        }
    }

    fn publish(&self, lease: &Lease, completion: Completion) -> Result<()> {
        let now = self.queue.now();
        let log = self.queue.job(&lease.job)?.spec.drive_log;
        let assets: Vec<Asset> = completion
            .assets
            .into_iter()
            .map(|content| Asset::publish(content, &log, &lease.job, now))
            .collect();
        self.check_publishable(&assets)?;
        if let Some(made) = &completion.decomposition {
            self.check_written(&made.manifest, &"the decomposition")?;
        }
        let event = Event::Completed {
            epoch: lease.epoch,
            assets: assets.iter().map(|asset| asset.id.clone()).collect(),
            report: self.write_report(&completion.report)?,
        };
        let decomposition = completion.decomposition.map(|made| DecompositionRecord {
            inputs: made.inputs,
            drive_log: log,
            manifest: made.manifest,
            job: lease.job.clone(),
            created_at: now,
        });
        self.queue.apply_with(&lease.job, event, |_| {
            let txn = assets
                .iter()
                .try_fold(Txn::new(), |txn, asset| txn.create(asset))?;
            self.keep(txn, decomposition.as_ref())
        })?;
        Ok(())
    }

    /// Adds a decomposition, or replaces one of the same inputs that could not be read.
    fn keep(&self, txn: Txn, made: Option<&DecompositionRecord>) -> store::Result<Txn> {
        let Some(made) = made else { return Ok(txn) };
        match self.queue.store().decomposition(&made.inputs)? {
            None => txn.create(made),
            Some(old) => txn.replace(&old, made),
        }
    }

    /// Every payload is on stable storage and no two assets share a name.
    fn check_publishable(&self, assets: &[Asset]) -> Result<()> {
        let mut names = BTreeSet::new();
        for asset in assets {
            if !names.insert(&asset.id) {
                return Err(Error::Invalid {
                    what: format!("{} would be published twice", asset.id),
                });
            }
            self.check_written(&asset.content.payload, &asset.id)?;
        }
        Ok(())
    }

    fn check_written(&self, blob: &BlobRef, of: &dyn Display) -> Result<()> {
        if self.blobs().size_bytes(&blob.digest)? != Some(blob.size_bytes) {
            return Err(Error::Invalid {
                what: format!("blob {} of {of} was not written", blob.digest),
            });
        }
        Ok(())
    }

    fn write_report(&self, report: &JobReport) -> Result<Option<BlobRef>> {
        if *report == JobReport::default() {
            return Ok(None);
        }
        let content = serde_json::to_vec(report).map_err(|e| Error::Invalid {
            what: e.to_string(),
        })?;
        Ok(Some(self.blobs().put(&content)?))
    }

    fn fail_lease(&self, lease: &Lease, failure: Failure) -> Result<()> {
        let epoch = lease.epoch;
        self.queue
            .apply(&lease.job, Event::Failed { epoch, failure })?;
        Ok(())
    }
}

impl WorkerPort for LocalPort {
    fn lease(&self, worker: &str) -> Result<Option<LeasedJob>, PortError> {
        Ok(self.lease_next(worker)?)
    }

    fn heartbeat(&self, lease: &Lease, progress: &Progress) -> Result<Directive, PortError> {
        Ok(self.beat(lease, progress)?)
    }

    fn read_blob(&self, digest: &Digest) -> Result<Bytes, PortError> {
        Ok(self.blobs().read(digest).map_err(Error::from)?)
    }

    fn decomposition(&self, inputs: &Digest) -> Result<Option<KnownDecomposition>, PortError> {
        let found = self.queue.store().decomposition(inputs);
        Ok(found
            .map_err(Error::from)?
            .map(|stored| KnownDecomposition {
                job: stored.record.job,
                manifest: stored.record.manifest,
            }))
    }

    fn write_blob(&self, content: &[u8]) -> Result<BlobRef, PortError> {
        Ok(self.blobs().put(content).map_err(Error::from)?)
    }

    fn complete(&self, lease: &Lease, completion: Completion) -> Result<(), PortError> {
        Ok(self.publish(lease, completion)?)
    }

    fn fail(&self, lease: &Lease, failure: Failure) -> Result<(), PortError> {
        Ok(self.fail_lease(lease, failure)?)
    }

    fn stopped(&self, lease: &Lease) -> Result<(), PortError> {
        let epoch = lease.epoch;
        self.queue.apply(&lease.job, Event::Stopped { epoch })?;
        Ok(())
    }

    fn release(&self, lease: &Lease) -> Result<(), PortError> {
        let epoch = lease.epoch;
        self.queue.apply(&lease.job, Event::Released { epoch })?;
        Ok(())
    }
}

impl From<Error> for PortError {
    fn from(error: Error) -> Self {
        Self {
            kind: error.kind(),
            message: error.to_string(),
        }
    }
}

impl Kinded for PortError {
    fn kind(&self) -> ErrorKind {
        self.kind
    }
}

fn directive(job: &Job, lease: &Lease) -> Directive {
    if job.epoch != lease.epoch || !job.is_running() {
        Directive::Lost
    } else if job.cancel_requested {
        Directive::Cancel
    } else {
        Directive::Continue
    }
}

fn is_commit_due(job: &Job, progress: &Progress, now: crate::domain::clock::UnixMs) -> bool {
    let JobState::Running { lease_ends, .. } = job.state else {
        return true;
    };
    job.progress.stage != progress.stage || now.plus(LEASE - COMMIT_EVERY) >= lease_ends
}
