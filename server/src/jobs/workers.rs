//! Worker threads: each leases a job, runs it and hands its outcome back through the port. They are named OS threads,
//! because training never runs on a tokio thread, and a panic in a job fails that job only.

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use super::queue::Queue;
use super::worker_port::{
    Completion, Directive, JobControl, LeasedJob, Outcome, PortError, StopCause, WorkerPort,
};
use crate::domain::job::Failure;
use crate::error::ErrorKind;

/// What a worker does with a job; blocks until it is done, and returns early once `control.cancelled()`.
pub type Execute =
    Arc<dyn Fn(&LeasedJob, &dyn WorkerPort, &JobControl) -> Outcome + Send + Sync + 'static>;

/// Time between two heartbeats: fast enough for a progress bar.
const PULSE: Duration = Duration::from_secs(1);

/// An idle worker looks for jobs that have become due this often.
const IDLE: Duration = Duration::from_secs(1);

/// Time between two searches for expired leases.
const REAP_EVERY: Duration = Duration::from_secs(5);

/// A finished job is worth more than a free worker: publication waits this often for space, `PUBLISH_WAIT` each time.
const PUBLISH_TRIES: u32 = 30;
const PUBLISH_WAIT: Duration = Duration::from_secs(2);

/// The running worker threads.
#[derive(Debug)]
pub struct Workers {
    shared: Arc<Shared>,
    threads: Vec<JoinHandle<()>>,
}

#[derive(Debug)]
struct Shared {
    queue: Arc<Queue>,
    state: Mutex<State>,
}

#[derive(Debug, Default)]
struct State {
    stopping: bool,
    running: Vec<Arc<JobControl>>,
}

impl Workers {
    /// Starts `count` workers and the thread that takes jobs from silent workers.
    pub fn start(
        count: usize,
        queue: Arc<Queue>,
        port: Arc<dyn WorkerPort>,
        execute: Execute,
    ) -> std::io::Result<Self> {
        let shared = Arc::new(Shared {
            queue,
            state: Mutex::default(),
        });
        let mut threads = vec![spawn("lease-reaper".into(), {
            let shared = shared.clone();
            move || shared.reap()
        })?];
        for i in 0..count {
            let name = format!("worker-{i}");
            threads.push(spawn(name.clone(), {
                let (shared, port, execute) = (shared.clone(), port.clone(), execute.clone());
                move || shared.work(&name, &*port, &execute)
            })?);
        }
        Ok(Self { shared, threads })
    }

    /// Stops claiming and tells running jobs to stop; they are given back to the queue.
    pub fn stop(&self) {
        let mut state = self.shared.lock();
        state.stopping = true;
        for control in &state.running {
            control.stop(StopCause::ShuttingDown);
        }
        drop(state);
        self.shared.queue.wake().notify();
    }

    /// Waits for the threads, at most until `deadline`; returns whether all have ended. A thread that has not is left
    /// behind: its job is found running at the next start.
    pub fn join(self, deadline: Instant) -> bool {
        const POLL: Duration = Duration::from_millis(10);
        while Instant::now() < deadline && !self.threads.iter().all(JoinHandle::is_finished) {
            std::thread::sleep(POLL);
        }
        let all_ended = self.threads.iter().all(JoinHandle::is_finished);
        for thread in self.threads.into_iter().filter(JoinHandle::is_finished) {
            let _ = thread.join();
        }
        all_ended
    }
}

impl Shared {
    fn lock(&self) -> std::sync::MutexGuard<'_, State> {
        self.state.lock().expect("no panic while held")
    }

    fn is_stopping(&self) -> bool {
        self.lock().stopping
    }

    fn reap(&self) {
        let mut last = Instant::now();
        while !self.is_stopping() {
            self.queue.wake().wait(self.queue.wake().signals(), IDLE);
            if last.elapsed() < REAP_EVERY {
                continue;
            }
            last = Instant::now();
            match self.queue.expire_leases() {
                Ok(0) => {}
                Ok(count) => tracing::warn!(count, "took jobs from silent workers"),
                Err(error) => tracing::warn!(%error, "cannot look for expired leases"),
            }
        }
    }

    fn work(&self, name: &str, port: &dyn WorkerPort, execute: &Execute) {
        while !self.is_stopping() {
            let seen = self.queue.wake().signals();
            match port.lease(name) {
                Ok(Some(job)) => self.run(&job, port, execute),
                Ok(None) => self.queue.wake().wait(seen, IDLE),
                Err(error) => {
                    tracing::warn!(%error, "cannot lease a job");
                    self.queue.wake().wait(seen, IDLE);
                }
            }
        }
    }

    fn run(&self, job: &LeasedJob, port: &dyn WorkerPort, execute: &Execute) {
        let lease = &job.lease;
        let span = tracing::info_span!("job", job = %lease.job, epoch = lease.epoch, attempt = lease.attempt);
        let _entered = span.enter();
        let Some(control) = self.begin() else {
            log_refusal("give back", port.release(lease));
            return;
        };
        tracing::info!(kind = ?job.spec.kind, drive_log = %job.drive_log, "began");
        std::thread::scope(|scope| {
            let pulse = || span.in_scope(|| beat(job, port, &control));
            if let Err(error) = std::thread::Builder::new()
                .name("job-pulse".into())
                .spawn_scoped(scope, pulse)
            {
                tracing::error!(%error, "cannot start the heartbeat");
            }
            let outcome = catch_unwind(AssertUnwindSafe(|| execute(job, port, &control)))
                .unwrap_or_else(|panic| Err(panicked(&*panic)));
            self.conclude(job, port, &control, outcome);
            control.end();
        });
        self.lock()
            .running
            .retain(|running| !Arc::ptr_eq(running, &control));
    }

    /// A control that `stop` reaches; `None` if the workers are stopping.
    fn begin(&self) -> Option<Arc<JobControl>> {
        let mut state = self.lock();
        if state.stopping {
            return None;
        }
        let control = Arc::new(JobControl::new());
        state.running.push(control.clone());
        Some(control)
    }

    fn conclude(
        &self,
        job: &LeasedJob,
        port: &dyn WorkerPort,
        control: &JobControl,
        outcome: Outcome,
    ) {
        let lease = &job.lease;
        match (outcome, control.stop_cause()) {
            (Ok(completion), _) => self.publish(job, port, completion),
            (Err(_), Some(StopCause::Cancelled)) => log_refusal("cancel", port.stopped(lease)),
            (Err(_), Some(StopCause::ShuttingDown)) => {
                log_refusal("give back", port.release(lease));
            }
            (Err(_), Some(StopCause::LeaseLost)) => tracing::warn!("the lease was lost"),
            (Err(failure), None) => {
                tracing::warn!(reason = failure.reason, message = failure.message, "failed");
                log_refusal("fail", port.fail(lease, failure));
            }
        }
    }

    fn publish(&self, job: &LeasedJob, port: &dyn WorkerPort, completion: Completion) {
        for attempt in 1..=PUBLISH_TRIES {
            match port.complete(&job.lease, completion.clone()) {
                Ok(()) => {
                    tracing::info!(assets = completion.assets.len(), "succeeded");
                    return;
                }
                Err(error) if is_passing(error.kind) && attempt < PUBLISH_TRIES => {
                    tracing::warn!(%error, "cannot publish yet");
                    if self.is_stopping() {
                        return;
                    }
                    std::thread::sleep(PUBLISH_WAIT);
                }
                Err(error) if error.kind == ErrorKind::LeaseLost => {
                    tracing::warn!(%error, "the lease was lost");
                    return;
                }
                Err(error) => {
                    let failure = Failure {
                        reason: "PUBLISH_FAILED".into(),
                        message: error.to_string(),
                        retryable: is_passing(error.kind),
                    };
                    log_refusal("fail", port.fail(&job.lease, failure));
                    return;
                }
            }
        }
    }
}

/// Heartbeats until the job ended.
fn beat(job: &LeasedJob, port: &dyn WorkerPort, control: &JobControl) {
    while let Some(progress) = control.next_beat(PULSE) {
        match port.heartbeat(&job.lease, &progress) {
            Ok(Directive::Continue) => {}
            Ok(Directive::Cancel) => control.stop(StopCause::Cancelled),
            Ok(Directive::Lost) => {
                control.stop(StopCause::LeaseLost);
                return;
            }
            // The lease has time for several more: a disk that is full for a moment ends no job.
            Err(error) => tracing::warn!(%error, "cannot send a heartbeat"),
        }
    }
}

fn is_passing(kind: ErrorKind) -> bool {
    matches!(kind, ErrorKind::Overloaded | ErrorKind::Unavailable)
}

fn panicked(panic: &(dyn Any + Send)) -> Failure {
    let message = panic
        .downcast_ref::<String>()
        .map(String::as_str)
        .or_else(|| panic.downcast_ref::<&str>().copied())
        .unwrap_or("without a message");
    Failure {
        reason: "PANIC".into(),
        message: format!("the job panicked: {message}"),
        retryable: true,
    }
}

fn log_refusal(verb: &str, outcome: Result<(), PortError>) {
    if let Err(error) = outcome {
        tracing::warn!(%error, "cannot {verb} the job");
    }
}

fn spawn(name: String, body: impl FnOnce() + Send + 'static) -> std::io::Result<JoinHandle<()>> {
    std::thread::Builder::new().name(name).spawn(body)
}
