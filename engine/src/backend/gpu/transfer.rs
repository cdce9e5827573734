//! Values that go to a device or come back piece by piece, between which the caller may change its mind.

use super::device::Device;
use super::error::Error;

/// Nodes of a piece, 4 MiB of quads: a millisecond or a few, and the transposed copy of a whole dense background would take half a gigabyte
/// a quad.
pub(super) const NODES_PER_COPY: usize = 1 << 18;

/// What goes to a device or comes back, as long as nobody cancels it.
#[derive(Clone, Copy)]
pub(super) struct Transfer<'a> {
    pub(super) device: &'a Device,
    cancelled: &'a dyn Fn() -> bool,
}

impl<'a> Transfer<'a> {
    pub(super) fn new(device: &'a Device, cancelled: &'a dyn Fn() -> bool) -> Self {
        Self { device, cancelled }
    }

    /// One that nobody cancels.
    pub(super) fn of_all(device: &'a Device) -> Self {
        Self::new(device, &|| false)
    }

    /// Ends a piece: waits until it is on the device and its staging memory free, and asks whether to go on.
    ///
    /// # Errors
    /// [`Error::Cancelled`] and [`Error::Lost`].
    pub(super) fn go_on(self) -> Result<(), Error> {
        self.device.flush()?;
        if (self.cancelled)() {
            return Err(Error::Cancelled);
        }
        Ok(())
    }
}
