//! The GPU backend: the kernels of `backlot-shaders` on whatever adapter wgpu finds, Mesa's software one included.

mod error;

mod device;

mod buffer;

mod pipeline;

mod kernel_times;

mod sequence;

mod parts;

mod pace;

mod transfer;

mod field;

mod features;

mod march;

mod network;

mod submissions;

mod durable;

mod train;

mod grid;

mod residency;

mod turns;

mod scene;

#[cfg(test)]
mod parity_tests;

pub use device::adapters;
pub use durable::DurableGpu;
pub use error::Error;
pub(crate) use grid::GpuGrid;
pub use kernel_times::KernelTimes;
pub use train::{GpuSums, GpuTrainer};

use std::sync::Arc;

use device::Device;
use submissions::free_groups;

use super::{AdapterChoice, Backend, GridDevice, LoadedField, Trainer};
use crate::Result;
use crate::field::Field;
use crate::scene::{RenderOptions, RenderedFrame, Scene};
use crate::train::dvgo::Stage;

/// An open GPU with its compiled kernels.
#[derive(Clone, Debug)]
pub struct GpuBackend {
    device: Device,
    scenes: Arc<scene::SceneRenderer>,
}

impl GpuBackend {
    /// Opens an adapter and compiles the kernels. Assets of `memory_bytes` stay on the device between renders.
    ///
    /// # Errors
    /// [`Error::NoAdapter`] where it is not there, [`Error::Open`] where the driver refuses.
    pub fn open(choice: &AdapterChoice, memory_bytes: u64) -> Result<Self, Error> {
        Self::on(Device::open(choice)?, memory_bytes)
    }

    fn on(device: Device, memory_bytes: u64) -> Result<Self, Error> {
        let scenes = Arc::new(scene::SceneRenderer::new(&device, memory_bytes)?);
        Ok(Self { device, scenes })
    }

    /// Whether the device is gone; a new one must be opened.
    pub fn is_lost(&self) -> bool {
        self.device.is_lost()
    }

    /// A trainer of `field` on this device. `cancelled` is asked between pieces of the upload.
    ///
    /// # Errors
    /// [`Error::TooLarge`] or [`Error::OutOfMemory`] where it does not fit, [`Error::Cancelled`] and [`Error::Lost`].
    pub fn open_trainer(
        &self,
        field: Field,
        cancelled: &dyn Fn() -> bool,
    ) -> Result<GpuTrainer, Error> {
        GpuTrainer::new(self.device.clone(), field, cancelled)
    }

    /// A dense grid's stage on this device, for a fresh optimiser. `cancelled` is asked between pieces of the upload.
    ///
    /// # Errors
    /// As [`Self::open_trainer`].
    pub(crate) fn open_grid<const C: usize>(
        &self,
        stage: &Stage<C>,
        cancelled: &dyn Fn() -> bool,
    ) -> Result<GpuGrid, Error> {
        GpuGrid::open(self.device.clone(), stage, cancelled)
    }

    /// Bytes of the assets that stay on the device.
    pub fn resident_bytes(&self) -> u64 {
        self.scenes.resident_bytes()
    }

    /// [`Self::open_trainer`] whose colour network takes four samples a thread, or one: for comparing the two.
    ///
    /// # Errors
    /// As [`Self::open_trainer`].
    #[doc(hidden)]
    pub fn open_variant(&self, field: Field, takes_four: bool) -> Result<GpuTrainer, Error> {
        GpuTrainer::with_variant(self.device.clone(), field, takes_four, &|| false)
    }

    /// Whether the device runs the kernels that take four samples a thread.
    #[doc(hidden)]
    pub fn has_four_sample_kernels(&self) -> bool {
        self.device.reads_together()
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
        let upload = transfer::Transfer::of_all(&self.device);
        let resident = field::ResidentField::upload(upload, field)?;
        Ok(Box::new(march::GpuField::new(
            self.device.clone(),
            resident,
        )?))
    }

    fn trainer(&self, field: Field, cancelled: &dyn Fn() -> bool) -> Result<Trainer> {
        Ok(Trainer::on_gpu(self.open_trainer(field, cancelled)?))
    }

    fn grid_device(&self) -> Result<GridDevice> {
        Ok(GridDevice::gpu(self.clone()))
    }

    fn render(
        &self,
        scene: &Scene<'_>,
        options: &RenderOptions,
        cancelled: &(dyn Fn() -> bool + Sync),
    ) -> Result<RenderedFrame> {
        self.scenes.render(&self.device, scene, options, cancelled)
    }
}
