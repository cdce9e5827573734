//! Processor time of all threads of this process, as Linux counts it.

use std::fs;
use std::time::Duration;

use criterion::measurement::{Measurement, ValueFormatter, WallTime};

pub(crate) struct CpuTime;

impl Measurement for CpuTime {
    type Intermediate = Duration;
    type Value = Duration;

    fn start(&self) -> Duration {
        now()
    }

    fn end(&self, start: Duration) -> Duration {
        now().saturating_sub(start)
    }

    fn add(&self, a: &Duration, b: &Duration) -> Duration {
        *a + *b
    }

    fn zero(&self) -> Duration {
        Duration::ZERO
    }

    fn to_f64(&self, value: &Duration) -> f64 {
        value.as_nanos() as f64
    }

    fn formatter(&self) -> &dyn ValueFormatter {
        WallTime.formatter()
    }
}

/// Sum of what the scheduler gave each thread, nanoseconds first in its record.
pub(crate) fn now() -> Duration {
    let threads = fs::read_dir("/proc/self/task").expect("processor time is read from /proc");
    let of = |thread: std::io::Result<fs::DirEntry>| -> Option<u64> {
        let record = fs::read_to_string(thread.ok()?.path().join("schedstat")).ok()?;
        record.split_whitespace().next()?.parse().ok()
    };
    Duration::from_nanos(threads.filter_map(of).sum())
}
