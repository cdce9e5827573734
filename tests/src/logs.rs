//! Small generated (synthetic) driving logs.

use std::collections::BTreeMap;
use std::sync::Mutex;

use backlot_client::generator::{LidarConfig, StreetConfig, StreetWorld};
use backlot_client::read_log::ReadLog;

/// A street that trains in seconds: small images, few frames, a short drive, few LiDAR beams. Equal seeds give equal logs.
///
/// # Panics
/// If the generator refuses its own defaults.
pub fn tiny(seed: u64) -> ReadLog {
    static MADE: Mutex<BTreeMap<u64, ReadLog>> = Mutex::new(BTreeMap::new());
    let mut made = MADE.lock().expect("no panic while making a log");
    let log = made
        .entry(seed)
        .or_insert_with(|| world(seed).read_log().expect("the street can be recorded"));
    ReadLog {
        drive_log: log.drive_log.clone(),
        blobs: log.blobs.clone(),
    }
}

/// The world of [`tiny`], which can render any view exactly.
///
/// # Panics
/// As [`tiny`].
pub fn world(seed: u64) -> StreetWorld {
    let lidar = LidarConfig {
        beams: 24,
        azimuth_step_rad: 1.0_f64.to_radians(),
        ..LidarConfig::default()
    };
    let config = StreetConfig {
        seed,
        frames: 12,
        width: 160,
        height: 96,
        travel_m: 18.0,
        supersample: 1,
        lidar,
        ..StreetConfig::default()
    };
    StreetWorld::new(&config).expect("the configuration is valid")
}
