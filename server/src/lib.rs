//! The Backlot service: driving logs come in, training jobs make assets of them, and labelled samples are rendered from those.
//!
//! Modules in reading order. `store` is the only place that knows sled or the data directory, `api` the only place that
//! knows wire messages; workers in `jobs` touch nothing but the worker port.

pub mod error;

pub mod config;
pub mod telemetry;

pub mod domain;

pub mod store;

pub mod segment;

pub mod ingest;

pub mod jobs;

pub mod samples;

pub mod api;

pub mod server;
