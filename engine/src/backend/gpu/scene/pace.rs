//! How much work one batch holds: enough to fill the device, little enough that others get their turn and a cancel is heeded.

use std::time::Duration;

/// A cancelled call must end within 100 ms of work.
const TARGET: Duration = Duration::from_millis(40);
const LEAST_RAYS: usize = 1024;
/// 64 Ki rays fill the largest card and take some 200 MiB of buffers.
const MOST_RAYS: usize = 1 << 16;

/// Rays of the next batch.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pace {
    rays: usize,
}

impl Pace {
    pub(super) fn new() -> Self {
        Self { rays: LEAST_RAYS }
    }

    pub(super) fn rays(self) -> usize {
        self.rays
    }

    /// The pace after a batch of `rays` took `elapsed`: at most twice or half the last one.
    pub(super) fn after(self, rays: usize, elapsed: Duration) -> Self {
        let ratio = TARGET.as_secs_f64() / elapsed.as_secs_f64().max(1e-6);
        // A batch that was cut short by the image's end says little about a full one.
        let from = rays.clamp(self.rays / 2, self.rays) as f64;
        let next = from * ratio.clamp(0.5, 2.0);
        Self {
            rays: (next as usize).clamp(LEAST_RAYS, MOST_RAYS),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Batches until the pace no longer moves on a device of this many rays a second.
    fn settled(rays_per_s: f64) -> usize {
        let mut pace = Pace::new();
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
        assert_eq!(settled(1e9), MOST_RAYS);
        assert_eq!(settled(1.0), LEAST_RAYS);
    }

    #[test]
    fn one_slow_batch_halves_it_at_most() {
        let pace = Pace { rays: 8192 };
        assert_eq!(pace.after(8192, Duration::from_secs(9)).rays(), 4096);
        assert_eq!(pace.after(8192, Duration::ZERO).rays(), 16_384);
        assert_eq!(pace.after(100, Duration::from_micros(1)).rays(), 8192);
    }
}
