//! Seconds of the wall, or of the processor.

use std::time::Instant;

use clap::ValueEnum;

#[derive(Clone, Copy, Debug, ValueEnum)]
pub(crate) enum Source {
    Wall,
    Cpu,
}

pub(crate) struct Clock {
    start: Instant,
    /// Processor seconds at the start, and the threads they are divided by; `None` for the wall.
    cpu: Option<(f64, f64)>,
}

impl Clock {
    /// Falls back on the wall where the system does not tell processor time.
    pub(crate) fn start(source: Source, threads: usize) -> Self {
        let cpu = match source {
            Source::Wall => None,
            Source::Cpu => cpu_s().map(|cpu_s| (cpu_s, threads as f64)),
        };
        Self {
            start: Instant::now(),
            cpu,
        }
    }

    pub(crate) fn seconds(&self) -> f64 {
        match (self.cpu, cpu_s()) {
            (Some((start_s, threads)), Some(now_s)) => (now_s - start_s) / threads,
            _ => self.start.elapsed().as_secs_f64(),
        }
    }
}

/// Linux reports times in ticks of 1/100 s on every architecture this runs on.
const TICKS_PER_S: f64 = 100.0;

/// User and system time of all threads of this process so far; the 14th and 15th field of proc(5)'s stat, counted from after
/// the name in parentheses, which may hold anything.
fn cpu_s() -> Option<f64> {
    let stat = std::fs::read_to_string("/proc/self/stat").ok()?;
    let (_, after_name) = stat.rsplit_once(')')?;
    let mut ticks = after_name.split_whitespace().skip(11);
    let user: f64 = ticks.next()?.parse().ok()?;
    let system: f64 = ticks.next()?.parse().ok()?;
    Some((user + system) / TICKS_PER_S)
}
