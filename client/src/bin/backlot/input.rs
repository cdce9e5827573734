//! Reading a log in the format the caller names.

use std::path::Path;

use backlot_client::generator::{StreetConfig, StreetWorld};
use backlot_client::kitti::{KittiInputs, read_kitti_raw};
use backlot_client::read_log::ReadLog;

use crate::args::{LogParts, StreetOptions};

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

/// The demo's street with another seed, and as much of it as asked for.
pub(crate) fn generate(seed: u64, street: &StreetOptions) -> anyhow::Result<ReadLog> {
    let demo = StreetConfig::default();
    let travel_m = street.travel_m.unwrap_or(demo.travel_m);
    let config = StreetConfig {
        seed,
        parked_cars: StreetConfig::parked_along(travel_m),
        frames: street.frames.unwrap_or(demo.frames),
        width: street.width.unwrap_or(demo.width),
        height: street.height.unwrap_or(demo.height),
        travel_m,
        ..demo
    };
    eprintln!("note: a generated log is synthetic: its images are ray-traced");
    Ok(StreetWorld::new(&config)?.read_log()?)
}
