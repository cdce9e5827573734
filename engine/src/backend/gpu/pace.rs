//! How many rays one batch holds: enough to fill the device, little enough that others get their turn and a cancel is heeded.

use std::time::Duration;

/// Rays of the next batch.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pace {
    target: Duration,
    rays: usize,
    least: usize,
    most: usize,
}

impl Pace {
    /// A first batch of `least` rays; none will have fewer nor more than `most`, and all shall take `target`. A cancelled call must end
    /// within 100 ms of work, a batch may be twice as dear as the one it was measured by, and software adapters work with several threads.
    pub(super) fn new(target: Duration, least: usize, most: usize) -> Self {
        let most = most.max(1);
        let least = least.clamp(1, most);
        Self {
            target,
            rays: least,
            least,
            most,
        }
    }

    pub(super) fn rays(self) -> usize {
        self.rays
    }

    /// The pace after a batch of `rays` took `elapsed`: at most twice or half the last one.
    pub(super) fn after(self, rays: usize, elapsed: Duration) -> Self {
        let ratio = self.target.as_secs_f64() / elapsed.as_secs_f64().max(1e-6);
        // A batch that was cut short by the end of its image or step says little about a full one.
        let from = rays.clamp(self.rays / 2, self.rays) as f64;
        let next = from * ratio.clamp(0.5, 2.0);
        Self {
            rays: (next as usize).clamp(self.least, self.most),
            ..self
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TARGET: Duration = Duration::from_millis(40);
    const LEAST: usize = 256;
    const MOST: usize = 1 << 16;

    /// Batches until the pace no longer moves on a device of this many rays a second.
    fn settled(rays_per_s: f64) -> usize {
        let mut pace = Pace::new(TARGET, LEAST, MOST);
        for _ in 0..40 {
            let elapsed = Duration::from_secs_f64(pace.rays() as f64 / rays_per_s);
            pace = pace.after(pace.rays(), elapsed);
        }
        pace.rays()
    }

    #[test]
    fn batches_take_the_target_on_any_device() {
        for rays_per_s in [40e3, 200e3, 1e6] {
            let took = settled(rays_per_s) as f64 / rays_per_s;
            assert!((0.035..0.045).contains(&took), "{rays_per_s}: {took} s");
        }
        assert_eq!(settled(1e9), MOST);
        assert_eq!(settled(1.0), LEAST);
    }

    #[test]
    fn one_slow_batch_halves_it_at_most() {
        let pace = Pace {
            rays: 8192,
            ..Pace::new(TARGET, LEAST, MOST)
        };
        assert_eq!(pace.after(8192, Duration::from_secs(9)).rays(), 4096);
        assert_eq!(pace.after(8192, Duration::ZERO).rays(), 16_384);
        assert_eq!(pace.after(100, Duration::from_micros(1)).rays(), 8192);
    }

    #[test]
    fn batches_that_are_never_as_large_as_they_may_do_not_let_the_pace_run_away() {
        let mut pace = Pace::new(TARGET, 16, MOST);
        for _ in 0..40 {
            pace = pace.after(pace.rays().min(100), Duration::from_micros(1));
        }
        assert!((100..=400).contains(&pace.rays()), "{pace:?}");
    }
}
