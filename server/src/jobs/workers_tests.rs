//! Workers on a real store: what a job's end, panic, cancellation and shutdown do.

use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};

use super::queue_tests::{open_store, spec};
use super::worker_port::{Completion, JobControl, LeasedJob, Outcome, WorkerPort};
use super::{Execute, LocalPort, Queue, Workers};
use crate::domain::asset::{NewAsset, QualityReport, Usage};
use crate::domain::clock::{SystemClock, UuidSource};
use crate::domain::job::{Failure, Job, JobReport, JobState};

/// Far above what any of these jobs takes; reaching it is a failure.
const PATIENCE: Duration = Duration::from_secs(60);

struct Site {
    _folder: tempfile::TempDir,
    queue: Arc<Queue>,
}

impl Site {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let store = open_store(folder.path());
        let clock = Arc::new(SystemClock::new());
        Self {
            _folder: folder,
            queue: Arc::new(Queue::new(store, clock, Arc::new(UuidSource))),
        }
    }

    fn start(&self, execute: Execute) -> Workers {
        let port = Arc::new(LocalPort::new(self.queue.clone()));
        Workers::start(1, self.queue.clone(), port, execute).unwrap()
    }

    fn wait_for(&self, job: &Job, what: impl Fn(&Job) -> bool) -> Job {
        let deadline = Instant::now() + PATIENCE;
        loop {
            let job = self.queue.job(&job.id).unwrap();
            if what(&job) {
                return job;
            }
            assert!(Instant::now() < deadline, "{job:?}");
            std::thread::sleep(Duration::from_millis(5));
        }
    }
}

fn end(workers: Workers) {
    workers.stop();
    assert!(workers.join(Instant::now() + PATIENCE));
}

fn until_stopped(_: &LeasedJob, _: &dyn WorkerPort, control: &JobControl) -> Outcome {
    while !control.cancelled() {
        std::thread::sleep(Duration::from_millis(5));
    }
    Err(Failure {
        reason: "STOPPED".into(),
        message: String::new(),
        retryable: false,
    })
}

fn one_background(_: &LeasedJob, port: &dyn WorkerPort, _: &JobControl) -> Outcome {
    let asset = NewAsset {
        object: None,
        usage: Usage::Library,
        payload: port.write_blob(b"field").unwrap(),
        quality: QualityReport::default(),
        synthetic: true,
    };
    let report = JobReport {
        free_masks: Default::default(),
        warnings: vec!["short drive".into()],
        tracks: Vec::new(),
    };
    Ok(Completion {
        assets: vec![asset],
        report,
        ..Completion::default()
    })
}

#[test]
fn a_finished_job_publishes_its_assets_and_its_report() {
    let site = Site::new();
    let job = site.queue.enqueue(spec(0), None).unwrap();
    let workers = site.start(Arc::new(one_background));
    let job = site.wait_for(&job, Job::is_ended);
    assert_eq!(job.state, JobState::Succeeded);
    let store = site.queue.store();
    let asset = store.asset(&job.assets[0]).unwrap();
    assert_eq!(asset.job, job.id);
    assert_eq!(
        &store.blobs().read(&asset.content.payload.digest).unwrap()[..],
        b"field"
    );
    let report = store.blobs().read(&job.report.unwrap().digest).unwrap();
    let report: JobReport = serde_json::from_slice(&report).unwrap();
    assert_eq!(report.warnings, ["short drive"]);
    end(workers);
}

#[test]
fn a_panic_fails_its_job_and_the_worker_goes_on() {
    let site = Site::new();
    let calls = Arc::new(AtomicU32::new(0));
    let seen = calls.clone();
    let execute: Execute = Arc::new(move |job, port, control| {
        if job.spec.seed == 0 {
            seen.fetch_add(1, Ordering::SeqCst);
            panic!("seed zero");
        }
        one_background(job, port, control)
    });
    let bad = site.queue.enqueue(spec(0), None).unwrap();
    let good = site.queue.enqueue(spec(1), None).unwrap();
    let workers = site.start(execute);
    let good = site.wait_for(&good, Job::is_ended);
    assert_eq!(good.state, JobState::Succeeded);
    let bad = site.wait_for(&bad, |job| job.attempt > 0 && job.is_queued());
    assert!(bad.progress.message.contains("seed zero"), "{bad:?}");
    assert!(calls.load(Ordering::SeqCst) > 0, "the panic never happened");
    end(workers);
}

#[test]
fn a_payload_that_was_not_written_is_not_published() {
    let site = Site::new();
    let job = site.queue.enqueue(spec(0), None).unwrap();
    let workers = site.start(Arc::new(|job, port, control| {
        let mut completion = one_background(job, port, control)?;
        completion.assets[0].payload = crate::domain::blob::BlobRef::of(b"never written");
        Ok(completion)
    }));
    let job = site.wait_for(&job, Job::is_ended);
    assert!(matches!(job.state, JobState::Failed { .. }), "{job:?}");
    assert!(
        site.queue
            .store()
            .assets("", 9, |_| true)
            .unwrap()
            .is_empty()
    );
    end(workers);
}

#[test]
fn cancelling_stops_a_running_job() {
    let site = Site::new();
    let job = site.queue.enqueue(spec(0), None).unwrap();
    let workers = site.start(Arc::new(until_stopped));
    site.wait_for(&job, Job::is_running);
    site.queue.cancel(&job.id).unwrap();
    let job = site.wait_for(&job, Job::is_ended);
    assert_eq!(job.state, JobState::Cancelled);
    end(workers);
}

#[test]
fn shutdown_gives_running_jobs_back_uncounted() {
    let site = Site::new();
    let job = site.queue.enqueue(spec(0), None).unwrap();
    let workers = site.start(Arc::new(until_stopped));
    site.wait_for(&job, Job::is_running);
    end(workers);
    let job = site.queue.job(&job.id).unwrap();
    assert!(job.is_queued());
    assert_eq!((job.attempt, job.crashes), (0, 0));
}
