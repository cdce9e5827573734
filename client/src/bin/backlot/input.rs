//! Reading a log in the format the caller names.

use std::path::Path;

use backlot_client::generator::{StreetConfig, StreetWorld};
use backlot_client::kitti::{KittiInputs, read_kitti_raw};
use backlot_client::read_log::ReadLog;

use crate::args::LogParts;

/// Reads a KITTI raw drive and tells what the reader ignored or assumed.
pub(crate) fn read_kitti(path: &Path, parts: &LogParts) -> anyhow::Result<ReadLog> {
    let log = read_kitti_raw(&KittiInputs {
        drive_dir: path.to_owned(),
        calib_dir: parts.calib_dir.clone(),
        poses: parts.poses.clone(),
        tracks: parts.tracks.clone(),
    })?;
    for note in &log.drive_log.notes {
        eprintln!("note: {note}");
    }
    Ok(log)
}

/// The demo's street with another seed.
pub(crate) fn generate(seed: u64) -> anyhow::Result<ReadLog> {
    let config = StreetConfig {
        seed,
        ..StreetConfig::default()
    };
    eprintln!("note: a generated log is synthetic: its images are ray-traced");
    Ok(StreetWorld::new(&config)?.read_log()?)
}
