//! Times on the wire.

use prost_types::Timestamp;

use crate::domain::clock::UnixMs;

pub(crate) fn timestamp(at: UnixMs) -> Timestamp {
    Timestamp {
        seconds: at.0.div_euclid(1_000),
        nanos: at.0.rem_euclid(1_000) as i32 * 1_000_000,
    }
}
