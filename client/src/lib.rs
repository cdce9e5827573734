//! Typed client of Backlot: dataset readers, the log generator, uploads, jobs, assets and samples.

pub mod error;

pub mod read_log;

pub mod generator;

pub mod argoverse;
pub mod kitti;
pub mod nuscenes;
pub mod waymo;

pub mod depth_maps;
pub mod log_format;
pub mod sfm_points;

pub mod geometry;
pub mod motion;

pub mod connection;
pub mod names;

mod violated_files;

pub mod upload;

pub mod download;
pub mod listing;
pub mod watch;

pub mod labels;
pub mod sample_files;

pub mod picture;

pub mod inspect;

pub use connection::Connection;
pub use error::{Error, Result};
