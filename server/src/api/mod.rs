//! The wire: conversions between `backlot.v1` messages and the domain, and the gRPC services. No message type leaves here.
//!
//! A handler checks, converts, calls and converts back. Whatever blocks runs on a blocking thread and to its end, so that
//! a call that is dropped half-way cuts no commit.

mod limits;

mod status;

mod blocking;
mod page;
mod time;

mod blobs;

pub mod convert_drive_log;
mod drive_logs;

mod convert_asset;
mod convert_clip;

mod assets;

mod convert_job;

mod jobs;

mod convert_recipe;
mod convert_sample;

mod samples;

mod layers;

mod router;

pub use router::{Services, serve};
