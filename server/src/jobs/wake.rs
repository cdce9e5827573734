//! Wakes idle workers when a job was queued.

use std::sync::{Condvar, Mutex};
use std::time::Duration;

/// A counter of signals that threads can wait for.
#[derive(Debug, Default)]
pub struct Wake {
    signals: Mutex<u64>,
    changed: Condvar,
}

impl Wake {
    /// The present count; pass it to `wait` so that a signal in between is not missed.
    pub fn signals(&self) -> u64 {
        *self.signals.lock().expect("no panic while held")
    }

    pub fn notify(&self) {
        *self.signals.lock().expect("no panic while held") += 1;
        self.changed.notify_all();
    }

    /// Waits until there was a signal after `seen`, at most `limit`.
    pub fn wait(&self, seen: u64, limit: Duration) {
        let signals = self.signals.lock().expect("no panic while held");
        let _ = self
            .changed
            .wait_timeout_while(signals, limit, |signals| *signals == seen)
            .expect("no panic while held");
    }
}
