//! Typed client of Backlot: dataset readers, the log generator, uploads, jobs, assets and samples.

pub mod read_log;

pub mod kitti;

pub mod geometry;
