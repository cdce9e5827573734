//! What a worker does with a leased job.

use super::worker_port::{JobControl, LeasedJob, Outcome, WorkerPort};
use crate::domain::job::Failure;

/// Runs one job to its end.
pub fn run(job: &LeasedJob, _port: &dyn WorkerPort, _control: &JobControl) -> Outcome {
    Err(Failure {
        reason: "UNSUPPORTED".into(),
        message: format!("this build cannot run {:?} jobs", job.spec.kind),
        retryable: false,
    })
}
