//! What the service is about: names, blobs, assets, snapshots and jobs, with their invariants and no IO.

pub mod clock;
pub mod ids;

pub mod blob;

pub mod asset;
pub mod snapshot;

pub mod job;

pub mod drive_log;
