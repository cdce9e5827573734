//! A GPU that outlives the loss of its device: drivers reset, cards drop off the bus, and the service goes on.

use std::sync::{Arc, Mutex, PoisonError};

use super::GpuBackend;
use crate::backend::{AdapterChoice, Backend, GridDevice, LoadedField, Trainer};
use crate::field::Field;
use crate::scene::{RenderOptions, RenderedFrame, Scene};
use crate::{Error, Result};

/// Opens its adapter again once the device is lost. What was resident is lost; frames are rendered again, training fails with
/// [`Error::Device`] and is retried by its queue.
#[derive(Debug)]
pub struct DurableGpu {
    choice: AdapterChoice,
    memory_bytes: u64,
    current: Mutex<GpuBackend>,
}

impl DurableGpu {
    /// # Errors
    /// As [`GpuBackend::open`].
    pub fn open(choice: &AdapterChoice, memory_bytes: u64) -> Result<Self, super::Error> {
        Ok(Self {
            choice: choice.clone(),
            memory_bytes,
            current: Mutex::new(GpuBackend::open(choice, memory_bytes)?),
        })
    }

    /// The open device; a new one if the last was lost.
    ///
    /// # Errors
    /// As [`GpuBackend::open`].
    pub fn current(&self) -> Result<GpuBackend, super::Error> {
        // Nothing is left half-done by a panic under this lock.
        let mut current = self.current.lock().unwrap_or_else(PoisonError::into_inner);
        if current.is_lost() {
            tracing::warn!(
                device = current.device(),
                "the device was lost: opening it again"
            );
            *current = GpuBackend::open(&self.choice, self.memory_bytes)?;
        }
        Ok(current.clone())
    }

    /// Runs `work` on the device, and once more on a new one if the device is lost under it.
    fn retried<T>(&self, work: impl Fn(&GpuBackend) -> Result<T>) -> Result<T> {
        let gpu = self.current()?;
        match work(&gpu) {
            Err(Error::Device { .. }) if gpu.is_lost() => work(&self.current()?),
            done => done,
        }
    }
}

impl Backend for DurableGpu {
    fn name(&self) -> &'static str {
        "gpu"
    }

    fn device(&self) -> String {
        let current = self.current.lock().unwrap_or_else(PoisonError::into_inner);
        current.device()
    }

    fn load(&self, field: &Arc<Field>) -> Result<Box<dyn LoadedField>> {
        self.retried(|gpu| gpu.load(field))
    }

    fn trainer(&self, field: Field, cancelled: &dyn Fn() -> bool) -> Result<Trainer> {
        self.current()?.trainer(field, cancelled)
    }

    fn grid_device(&self) -> Result<GridDevice> {
        self.current()?.grid_device()
    }

    fn render(
        &self,
        scene: &Scene<'_>,
        options: &RenderOptions,
        cancelled: &(dyn Fn() -> bool + Sync),
    ) -> Result<RenderedFrame> {
        self.retried(|gpu| gpu.render(scene, options, cancelled))
    }
}
