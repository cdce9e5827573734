//! Small generated (synthetic) driving logs.

use std::collections::BTreeMap;
use std::sync::Mutex;

use backlot_client::generator::{LidarConfig, StreetConfig, StreetWorld};
use backlot_client::read_log::ReadLog;

/// A street that trains in seconds: small images, few frames, a short drive, few LiDAR beams. Equal seeds give equal logs.
/// Its objects are too few pixels to be reconstructed.
///
/// # Panics
/// If the generator refuses its own defaults.
pub fn tiny(seed: u64) -> ReadLog {
    static MADE: Mutex<BTreeMap<u64, ReadLog>> = Mutex::new(BTreeMap::new());
    let mut made = MADE.lock().expect("no panic while making a log");
    let log = made
        .entry(seed)
        .or_insert_with(|| record(seed, (160, 96), 12, 18.0));
    copy(log)
}

/// The same log once more.
pub fn copy(log: &ReadLog) -> ReadLog {
    ReadLog {
        drive_log: log.drive_log.clone(),
        blobs: log.blobs.clone(),
    }
}

/// A street whose nearest cars can be reconstructed.
///
/// # Panics
/// As [`tiny`].
pub fn small(seed: u64) -> ReadLog {
    record(seed, (320, 192), 20, 24.0)
}

/// A street full of cars that hide each other, recorded without noise.
///
/// # Panics
/// As [`tiny`].
pub fn crowded(seed: u64) -> ReadLog {
    record(seed, (400, 240), 30, 30.0)
}

fn record(seed: u64, (width, height): (u32, u32), frames: u32, travel_m: f64) -> ReadLog {
    let lidar = LidarConfig {
        beams: 24,
        azimuth_step_rad: 1.0_f64.to_radians(),
        ..LidarConfig::default()
    };
    let config = StreetConfig {
        seed,
        frames,
        width,
        height,
        travel_m,
        supersample: 1,
        lidar,
        ..StreetConfig::default()
    };
    let world = StreetWorld::new(&config).expect("the configuration is valid");
    world.read_log().expect("the street can be recorded")
}
