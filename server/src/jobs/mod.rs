//! Durable jobs: a queue with leases, recovery at start, and workers that touch only the worker port.

pub mod worker_port;
