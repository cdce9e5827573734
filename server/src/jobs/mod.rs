//! Durable jobs: a queue with leases, recovery at start, and workers that touch only the worker port.
//!
//! `queue` persists what the pure `domain::job` decides; `worker_port` is all a worker may touch, `local_port` its form
//! inside the server's process; `workers` are the threads; `feed` shows changes to watchers.

mod error;

mod wake;

mod feed;

mod queue;
#[cfg(test)]
mod queue_tests;

pub mod worker_port;

mod local_port;

pub mod execute;

mod workers;
#[cfg(test)]
mod workers_tests;

pub use error::{Error, Result};
pub use local_port::LocalPort;
pub use queue::Queue;
pub use workers::{Execute, Workers};
