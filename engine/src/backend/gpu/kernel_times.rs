//! What each kernel of a step takes, for tuning them.

use std::time::Duration;

/// Times by kernel, in the order in which kernels ran first, on the caller's clock.
#[derive(Clone, Debug)]
pub struct KernelTimes {
    clock: fn() -> Duration,
    spent: Vec<(&'static str, Duration)>,
}

impl KernelTimes {
    pub fn new(clock: fn() -> Duration) -> Self {
        Self {
            clock,
            spent: Vec::new(),
        }
    }

    /// Kernels and what all their runs took.
    pub fn spent(&self) -> &[(&'static str, Duration)] {
        &self.spent
    }

    pub(super) fn now(&self) -> Duration {
        (self.clock)()
    }

    /// Adds what has passed since `began` to a kernel's time.
    pub(super) fn add(&mut self, kernel: &'static str, began: Duration) {
        let took = self.now().saturating_sub(began);
        match self.spent.iter_mut().find(|(name, _)| *name == kernel) {
            Some((_, spent)) => *spent += took,
            None => self.spent.push((kernel, took)),
        }
    }
}
