//! Hands the pieces of a step to the device, turn by turn.

use std::time::{Duration, Instant};

use super::device::Device;
use super::error::Error;
use super::kernel_times::KernelTimes;
use super::pipeline::Groups;
use super::sequence::Sequence;
use super::turns::Priority;

/// The device may be one submission behind the host, or a cancelled run would go on for long.
#[derive(Debug, Default)]
pub(super) struct Submissions {
    pending: Option<wgpu::SubmissionIndex>,
    busy: Duration,
    /// Kernels run one by one while there are any.
    times: Option<KernelTimes>,
}

impl Submissions {
    /// Submits, in a turn of its own, what `write` puts into buffers and returns.
    pub(super) fn run<'a>(
        &mut self,
        device: &'a Device,
        write: impl FnOnce() -> Sequence<'a>,
    ) -> Result<(), Error> {
        let turn = device.turn(Priority::Training);
        let began = Instant::now();
        let sequence = write();
        let submission = match &mut self.times {
            Some(times) => sequence.submit_timed(times)?,
            None => sequence.submit()?,
        };
        let last = self.pending.replace(submission);
        // Whoever waits gets an idle device; what is measured is then this turn's work, and not theirs.
        let settled = if turn.is_wanted() {
            self.pending.take()
        } else {
            last
        };
        if let Some(submission) = settled {
            device.wait_for(submission)?;
        }
        self.busy += began.elapsed();
        Ok(())
    }

    /// Waits for everything that was submitted.
    pub(super) fn settle(&mut self, device: &Device) -> Result<(), Error> {
        if let Some(submission) = self.pending.take() {
            let began = Instant::now();
            device.wait_for(submission)?;
            self.busy += began.elapsed();
        }
        Ok(())
    }

    /// Takes the times of kernels from now on, if `times` are given, and returns those taken so far.
    pub(super) fn time_kernels(&mut self, times: Option<KernelTimes>) -> Option<KernelTimes> {
        std::mem::replace(&mut self.times, times)
    }

    pub(super) fn times_kernels(&self) -> bool {
        self.times.is_some()
    }

    /// How long the device was busy since the last call, as far as anybody waited for it.
    pub(super) fn take_busy(&mut self) -> Duration {
        std::mem::take(&mut self.busy)
    }
}

/// Bricks that one submission moves. A brick's step moves up to 140 kB: 16 Ki bricks take 23 ms at the 100 GB/s of a small GPU,
/// and 1,024 about as long on a software adapter.
pub(super) fn bricks_per_submission(device: &Device) -> usize {
    if device.is_software() {
        1 << 10
    } else {
        1 << 14
    }
}

/// # Errors
/// [`crate::Error::Cancelled`] if `cancelled` says so.
pub(super) fn go_on(cancelled: &dyn Fn() -> bool) -> crate::Result<()> {
    if cancelled() {
        return Err(crate::Error::Cancelled);
    }
    Ok(())
}

/// Workgroups of kernels that take items until there are no more. In software no more than keep its processors busy: what else is
/// launched finds nothing to do.
pub(super) fn free_groups(device: &Device) -> Groups {
    let x = device.processors().map_or(4096, |count| 2 * count);
    Groups { x, y: 1 }
}
