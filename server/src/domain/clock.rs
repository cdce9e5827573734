//! Time and identifiers enter the service through these two traits, so that queues and leases are tested without sleeping.

use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use serde::{Deserialize, Serialize};

/// Milliseconds since the Unix epoch, UTC.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(transparent)]
pub struct UnixMs(pub i64);

impl UnixMs {
    pub fn plus(self, span: Duration) -> Self {
        Self(self.0.saturating_add(span.as_millis() as i64))
    }
}

/// Tells the time.
pub trait Clock: Send + Sync + std::fmt::Debug {
    fn now(&self) -> UnixMs;
}

/// The machine's wall clock read once, then advanced by the monotonic clock: a step of the wall clock ends no lease.
#[derive(Debug)]
pub struct SystemClock {
    start: UnixMs,
    since: Instant,
}

impl SystemClock {
    pub fn new() -> Self {
        let elapsed = SystemTime::now()
            .duration_since(UNIX_EPOCH)
            .unwrap_or_default();
        Self {
            start: UnixMs(elapsed.as_millis() as i64),
            since: Instant::now(),
        }
    }
}

impl Default for SystemClock {
    fn default() -> Self {
        Self::new()
    }
}

impl Clock for SystemClock {
    fn now(&self) -> UnixMs {
        self.start.plus(self.since.elapsed())
    }
}

/// Makes identifiers that are unique in the data directory and sort by creation.
pub trait IdSource: Send + Sync + std::fmt::Debug {
    /// Lower-case letters, digits and dashes.
    fn next_id(&self) -> String;
}

/// UUID version 7.
#[derive(Debug, Default)]
pub struct UuidSource;

impl IdSource for UuidSource {
    fn next_id(&self) -> String {
        uuid::Uuid::now_v7().to_string()
    }
}
