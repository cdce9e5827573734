//! The durable queue: every change of a job is `Job::apply` committed under the condition that the job is as it was read.

use std::sync::Arc;

use tokio::sync::watch;

use super::error::{Error, Result};
use super::feed::Feed;
use super::wake::Wake;
use crate::domain::clock::{Clock, IdSource, UnixMs};
use crate::domain::ids::JobId;
use crate::domain::job::{Event, Job, JobSpec, Rejected};
use crate::store::{self, Store, Stored, Txn};

/// Jobs that may wait. More would take longer than anyone waits.
const MAX_QUEUED: usize = 10_000;

/// Queued jobs looked at together while searching one that is due.
const CLAIM_BATCH: usize = 64;

/// Two writers of one job are the worker and a canceller: the loser of a race tries again.
const MAX_TRIES: u32 = 16;

/// The queue of one store.
#[derive(Debug)]
pub struct Queue {
    store: Store,
    clock: Arc<dyn Clock>,
    ids: Arc<dyn IdSource>,
    feed: Feed,
    wake: Wake,
}

impl Queue {
    pub fn new(store: Store, clock: Arc<dyn Clock>, ids: Arc<dyn IdSource>) -> Self {
        Self {
            store,
            clock,
            ids,
            feed: Feed::default(),
            wake: Wake::default(),
        }
    }

    pub fn now(&self) -> UnixMs {
        self.clock.now()
    }

    /// Signalled when a job was queued.
    pub fn wake(&self) -> &Wake {
        &self.wake
    }

    pub(super) fn store(&self) -> &Store {
        &self.store
    }

    pub(super) fn feed(&self) -> &Feed {
        &self.feed
    }

    /// Queues a job; the same `request_id` with the same spec returns the job it made.
    pub fn enqueue(&self, spec: JobSpec, request_id: Option<&str>) -> Result<Job> {
        if self.store.queued_jobs("", MAX_QUEUED)?.len() == MAX_QUEUED {
            return Err(Error::QueueFull { limit: MAX_QUEUED });
        }
        self.store.drive_log(&spec.drive_log)?;
        let id = JobId::new(&self.ids.next_id()).map_err(|e| Error::Invalid {
            what: e.to_string(),
        })?;
        let job = self
            .store
            .create_job(Job::new(id, spec, self.now()), request_id)?;
        self.wake.notify();
        Ok(job)
    }

    pub fn job(&self, id: &JobId) -> Result<Job> {
        Ok(self.store.job(id)?.record)
    }

    /// Up to `limit` jobs with ids greater than `after` for which `keep` holds.
    pub fn jobs(&self, after: &str, limit: usize, keep: impl Fn(&Job) -> bool) -> Result<Vec<Job>> {
        Ok(self.store.jobs(after, limit, keep)?)
    }

    /// The job's state now and from now on.
    pub fn watch(&self, id: &JobId) -> Result<watch::Receiver<Job>> {
        self.feed.subscribe(id, || self.job(id))
    }

    /// Gives the oldest due job to `worker`.
    pub fn claim(&self, worker: &str) -> Result<Option<Job>> {
        let mut after = String::new();
        loop {
            let batch = self.store.queued_jobs(&after, CLAIM_BATCH)?;
            for id in &batch {
                let worker = worker.to_owned();
                match self.apply(id, Event::Claimed { worker }) {
                    Ok(job) => return Ok(Some(job)),
                    // Not due, or another worker or a canceller was faster.
                    Err(Error::Rejected { .. }) => {}
                    Err(e) => return Err(e),
                }
            }
            match batch.last() {
                Some(last) if batch.len() == CLAIM_BATCH => after = last.as_str().to_owned(),
                _ => return Ok(None),
            }
        }
    }

    /// Asks a job to stop.
    pub fn cancel(&self, id: &JobId) -> Result<Job> {
        self.apply(id, Event::CancelRequested)
    }

    /// Applies an event and commits the result.
    pub fn apply(&self, id: &JobId, event: Event) -> Result<Job> {
        self.apply_with(id, event, |_| Ok(Txn::new()))
    }

    /// Applies an event and commits the result together with what `also` makes of the next job.
    pub fn apply_with(
        &self,
        id: &JobId,
        event: Event,
        also: impl Fn(&Job) -> store::Result<Txn>,
    ) -> Result<Job> {
        for _ in 0..MAX_TRIES {
            let old = self.store.job(id)?;
            let next = self.next(&old, event.clone())?;
            match self.store.replace_job(&old, &next, also(&next)?) {
                Ok(()) => {
                    self.feed.publish(&next);
                    if next.is_queued() {
                        self.wake.notify();
                    }
                    return Ok(next);
                }
                Err(store::Error::Conflict { .. }) => {}
                Err(e) => return Err(e.into()),
            }
        }
        Err(store::Error::Conflict {
            key: id.to_string(),
        }
        .into())
    }

    fn next(&self, old: &Stored<Job>, event: Event) -> Result<Job> {
        old.record
            .apply(event, self.now())
            .map_err(|rejected| Error::Rejected {
                job: old.record.id.to_string(),
                rejected,
            })
    }

    /// Takes jobs from workers that were silent too long; returns how many.
    pub fn expire_leases(&self) -> Result<usize> {
        self.apply_to_running(Event::LeaseExpired)
    }

    /// At start, before any worker: every running job belongs to a dead process. Returns how many there were.
    pub fn recover(&self) -> Result<usize> {
        self.apply_to_running(Event::ProcessDied)
    }

    fn apply_to_running(&self, event: Event) -> Result<usize> {
        let mut count = 0;
        for id in self.store.running_jobs()? {
            match self.apply(&id, event.clone()) {
                Ok(_) => count += 1,
                Err(Error::Rejected {
                    rejected: Rejected::LeaseHolds | Rejected::NotRunning,
                    ..
                }) => {}
                Err(e) => return Err(e),
            }
        }
        Ok(count)
    }
}
