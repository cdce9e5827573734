//! Small generated (synthetic) driving logs.

use backlot_client::generator::{StreetConfig, StreetWorld};
use backlot_client::read_log::ReadLog;

/// A street that trains in seconds: small images, few frames, a short drive.
///
/// # Panics
/// If the generator refuses its own defaults.
pub fn tiny(seed: u64) -> ReadLog {
    world(seed).read_log().expect("the street can be recorded")
}

/// The world of [`tiny`], which can render any view exactly.
///
/// # Panics
/// As [`tiny`].
pub fn world(seed: u64) -> StreetWorld {
    StreetWorld::new(&StreetConfig {
        seed,
        frames: 12,
        width: 160,
        height: 96,
        travel_m: 18.0,
        ..StreetConfig::default()
    })
    .expect("the configuration is valid")
}
