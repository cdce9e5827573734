//! Random histories of the queue against a model in memory, with crashes that reopen the store.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicI64, AtomicU64, Ordering};

use proptest::prelude::*;

use super::{Error, Queue};
use crate::domain::blob::BlobRef;
use crate::domain::clock::{Clock, IdSource, UnixMs};
use crate::domain::ids::{DriveLogId, JobId};
use crate::domain::job::{
    Budget, Event, Failure, JobKind, JobSpec, JobState, MAX_ATTEMPTS, MAX_CRASHES, Progress,
};
use crate::store::{DriveLogRecord, Store, StoreConfig};

#[derive(Debug, Default)]
pub(super) struct TestClock(pub(super) AtomicI64);

impl Clock for TestClock {
    fn now(&self) -> UnixMs {
        UnixMs(self.0.load(Ordering::SeqCst))
    }
}

#[derive(Debug, Default)]
pub(super) struct Serial(AtomicU64);

impl IdSource for Serial {
    fn next_id(&self) -> String {
        format!("j{:08}", self.0.fetch_add(1, Ordering::SeqCst))
    }
}

pub(super) fn open_store(folder: &Path) -> Store {
    let store = Store::open(&StoreConfig {
        data_dir: folder.to_owned(),
        low_water_bytes: 0,
        ballast_bytes: 0,
    })
    .unwrap();
    store
        .create_drive_log(DriveLogRecord {
            id: DriveLogId::new("street").unwrap(),
            manifest: BlobRef::of(b""),
            dataset: "generated".into(),
            synthetic: true,
            camera_count: 1,
            frame_count: 1,
            sweep_count: 0,
            track_count: 0,
            travel_m: 1.0,
            created_at: UnixMs(0),
        })
        .unwrap();
    store
}

pub(super) fn spec(seed: u64) -> JobSpec {
    JobSpec {
        kind: JobKind::Background,
        drive_log: DriveLogId::new("street").unwrap(),
        budget: Budget::Quick,
        seed,
        hold_out_every: 8,
    }
}

#[derive(Clone, Debug)]
enum Step {
    Enqueue { request: u8 },
    Claim,
    Heartbeat { lease: usize },
    Complete { lease: usize },
    Fail { lease: usize },
    Cancel { job: usize },
    Advance { ms: i64 },
    Reap,
    Crash,
}

fn step() -> impl Strategy<Value = Step> {
    prop_oneof![
        3 => (0u8..6).prop_map(|request| Step::Enqueue { request }),
        6 => Just(Step::Claim),
        3 => (0usize..8).prop_map(|lease| Step::Heartbeat { lease }),
        2 => (0usize..8).prop_map(|lease| Step::Complete { lease }),
        2 => (0usize..8).prop_map(|lease| Step::Fail { lease }),
        1 => (0usize..8).prop_map(|job| Step::Cancel { job }),
        3 => (0i64..40_000).prop_map(|ms| Step::Advance { ms }),
        2 => Just(Step::Reap),
        1 => Just(Step::Crash),
    ]
}

/// What must be true of the queue, kept apart from its code.
#[derive(Default)]
struct Model {
    /// Job of each request.
    requests: BTreeMap<u8, JobId>,
    /// Every lease ever given: job, epoch.
    leases: Vec<(JobId, u64)>,
    /// The one lease of a job that may still act.
    holder: BTreeMap<JobId, u64>,
    completed: BTreeMap<JobId, u32>,
}

struct World {
    folder: tempfile::TempDir,
    clock: Arc<TestClock>,
    ids: Arc<Serial>,
    queue: Option<Queue>,
    model: Model,
}

impl World {
    fn new() -> Self {
        let mut world = Self {
            folder: tempfile::tempdir().unwrap(),
            clock: Arc::default(),
            ids: Arc::default(),
            queue: None,
            model: Model::default(),
        };
        world.open();
        world
    }

    /// A crash is a reopening without any goodbye to the queue.
    fn open(&mut self) {
        self.queue = None;
        let store = open_store(self.folder.path());
        self.queue = Some(Queue::new(store, self.clock.clone(), self.ids.clone()));
    }

    fn queue(&self) -> &Queue {
        self.queue.as_ref().unwrap()
    }

    fn take(&mut self, step: Step) {
        match step {
            Step::Enqueue { request } => self.enqueue(request),
            Step::Claim => self.claim(),
            Step::Heartbeat { lease } => {
                let progress = Progress::default();
                self.act(lease, |epoch| Event::Heartbeat {
                    epoch,
                    progress: progress.clone(),
                });
            }
            Step::Complete { lease } => self.complete(lease),
            Step::Fail { lease } => self.fail(lease),
            Step::Cancel { job } => self.cancel(job),
            Step::Advance { ms } => {
                self.clock.0.fetch_add(ms, Ordering::SeqCst);
            }
            Step::Reap => {
                self.queue().expire_leases().unwrap();
                self.forget_lost_leases();
            }
            Step::Crash => {
                self.open();
                self.queue().recover().unwrap();
                self.model.holder.clear();
            }
        }
    }

    fn enqueue(&mut self, request: u8) {
        let id = format!("request-{request}");
        let job = self
            .queue()
            .enqueue(spec(request.into()), Some(&id))
            .unwrap();
        let known = self.model.requests.entry(request).or_insert(job.id.clone());
        assert_eq!(*known, job.id, "a repeated request made a second job");
        let other = self.queue().enqueue(spec(99), Some(&id));
        assert!(other.is_err(), "a request id was reused for another job");
    }

    fn claim(&mut self) {
        if let Some(job) = self.queue().claim("w").unwrap() {
            let earlier = self.model.leases.iter().filter(|(id, _)| *id == job.id);
            assert!(
                earlier
                    .map(|(_, epoch)| *epoch)
                    .all(|epoch| epoch < job.epoch)
            );
            let before = self.model.holder.insert(job.id.clone(), job.epoch);
            assert_eq!(before, None, "a job was given to two workers");
            self.model.leases.push((job.id, job.epoch));
        }
    }

    /// Applies a worker's event with one of all leases ever given, and checks that only the holder's takes effect.
    fn act(&mut self, lease: usize, event: impl Fn(u64) -> Event) -> bool {
        let Some((id, epoch)) = self.model.leases.get(lease).cloned() else {
            return false;
        };
        let before = self.queue().job(&id).unwrap();
        let outcome = self.queue().apply(&id, event(epoch));
        let holds = self.model.holder.get(&id) == Some(&epoch);
        assert_eq!(outcome.is_ok(), holds, "{outcome:?}");
        if !holds {
            assert_eq!(
                self.queue().job(&id).unwrap(),
                before,
                "a stale lease acted"
            );
        }
        holds
    }

    fn complete(&mut self, lease: usize) {
        let done = self.act(lease, |epoch| Event::Completed {
            epoch,
            assets: Vec::new(),
            report: None,
        });
        if done {
            let id = self.model.leases[lease].0.clone();
            self.model.holder.remove(&id);
            *self.model.completed.entry(id).or_default() += 1;
        }
    }

    fn fail(&mut self, lease: usize) {
        let failure = Failure {
            reason: "DIVERGED".into(),
            message: "loss".into(),
            retryable: true,
        };
        let failed = self.act(lease, |epoch| Event::Failed {
            epoch,
            failure: failure.clone(),
        });
        if failed {
            self.model.holder.remove(&self.model.leases[lease].0);
        }
    }

    fn cancel(&mut self, job: usize) {
        let Some(id) = self.model.requests.values().nth(job).cloned() else {
            return;
        };
        let ended = self.queue().job(&id).unwrap().is_ended();
        assert_eq!(self.queue().cancel(&id).is_err(), ended);
    }

    /// The reaper took jobs whose lease had ended; the model learns which from the clock alone.
    fn forget_lost_leases(&mut self) {
        let queue = self.queue.as_ref().unwrap();
        self.model
            .holder
            .retain(|id, _| queue.job(id).unwrap().is_running());
    }

    fn check(&self) {
        let running: Vec<JobId> = self.queue().store().running_jobs().unwrap();
        let held: Vec<JobId> = self.model.holder.keys().cloned().collect();
        assert_eq!(running, held, "running jobs are exactly the held ones");
        let queued = self.queue().store().queued_jobs("", usize::MAX).unwrap();
        for id in self.model.requests.values() {
            let job = self.queue().job(id).expect("no acknowledged job is lost");
            assert_eq!(job.is_queued(), queued.contains(id));
            assert!(job.attempt <= MAX_ATTEMPTS && job.crashes <= MAX_CRASHES);
            let completed = self.model.completed.get(id).copied().unwrap_or_default();
            assert_eq!(completed, u32::from(job.state == JobState::Succeeded));
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, ..ProptestConfig::default() })]

    #[test]
    fn any_history_keeps_the_promises(steps in proptest::collection::vec(step(), 1..60)) {
        let mut world = World::new();
        for step in steps {
            world.take(step);
            world.check();
        }
    }
}

#[test]
fn a_job_needs_its_drive_log() {
    let folder = tempfile::tempdir().unwrap();
    let store = open_store(folder.path());
    let queue = Queue::new(
        store.clone(),
        Arc::new(TestClock::default()),
        Arc::new(Serial::default()),
    );
    store
        .delete_drive_log(&DriveLogId::new("street").unwrap())
        .unwrap();
    let error = queue.enqueue(spec(0), None).unwrap_err();
    assert!(
        matches!(error, Error::Store(crate::store::Error::NotFound { .. })),
        "{error}"
    );
}
