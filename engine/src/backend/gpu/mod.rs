//! The GPU backend: the kernels of `backlot-shaders` on whatever adapter wgpu finds, Mesa's software one included.

mod error;

mod device;

mod buffer;

mod pipeline;

mod field;

mod march;

#[cfg(test)]
mod parity_tests;

pub use device::Device;
pub use error::Error;

use std::sync::Arc;

use super::{Backend, LoadedField};
use crate::Result;
use crate::field::Field;

/// An open GPU with its compiled kernels.
#[derive(Clone, Debug)]
pub struct GpuBackend {
    device: Device,
    march: Arc<march::MarchDensity>,
}

impl GpuBackend {
    /// Opens the best adapter of this machine.
    ///
    /// # Errors
    /// [`Error::NoAdapter`] where there is none; see [`Device::open`].
    pub fn open() -> Result<Self, Error> {
        let device = Device::open()?;
        let march = Arc::new(march::MarchDensity::new(&device)?);
        Ok(Self { device, march })
    }

    /// Kernels dispatched on this device so far.
    pub fn dispatch_count(&self) -> u64 {
        self.device.dispatch_count()
    }
}

impl Backend for GpuBackend {
    fn name(&self) -> &'static str {
        "gpu"
    }

    fn device(&self) -> String {
        self.device.description()
    }

    fn load(&self, field: &Arc<Field>) -> Result<Box<dyn LoadedField>> {
        let resident = field::ResidentField::upload(&self.device, field)?;
        Ok(Box::new(march::GpuField::new(
            self.device.clone(),
            Arc::clone(&self.march),
            resident,
        )))
    }
}
