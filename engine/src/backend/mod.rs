//! Where the engine's arithmetic runs: one boundary, two implementations.
//!
//! A [`Backend`] is a device; a [`LoadedField`] is a field resident on it. Callers hand over borrowed host data and get host data
//! back, in stages whose decisions (how many samples, where) are in the result, so that a later stage never decides again.
//! Storage is the field's own: brick-sparse levels behind dense indices, split by parameter (density apart from features).
//! `cpu` runs everywhere and is the oracle; `gpu` runs the kernels of `backlot-shaders` on what wgpu finds. Nothing outside
//! `gpu` names wgpu. [`open`] makes the backend of a [`DeviceChoice`].

mod adapter;

mod choice;

mod marched;

mod trainer;

mod grid_device;

#[doc(hidden)]
pub mod bench_scene;

pub mod cpu;

#[cfg(feature = "gpu")]
pub mod gpu;

#[cfg(all(test, feature = "gpu"))]
mod stages;

#[cfg(test)]
mod test_scene;

pub use adapter::{AdapterKind, AdapterRecord, adapters};
pub use choice::{AdapterChoice, DeviceChoice, open};
pub use grid_device::GridDevice;
pub(crate) use grid_device::{GridArithmetic, GridOn};
pub use marched::{Marched, RaySummary};
#[cfg(feature = "gpu")]
pub(crate) use trainer::is_reported;
pub use trainer::{StepReport, Trainer};

use std::fmt::Debug;
use std::sync::Arc;

use crate::Result;
use crate::field::{Field, MarchRange, Ray};
use crate::scene::{RenderOptions, RenderedFrame, Scene};

/// A device that computes.
pub trait Backend: Send + Sync + Debug {
    /// `cpu` or `gpu`.
    fn name(&self) -> &'static str;

    /// Device, driver and instruction set in one line, for people and for the provenance of what is computed here.
    fn device(&self) -> String;

    /// Makes a field resident. It stays as it was at this moment.
    ///
    /// # Errors
    /// [`crate::Error::OutOfMemory`] with needed and available bytes where it does not fit, [`crate::Error::Device`] if the device is lost.
    fn load(&self, field: &Arc<Field>) -> Result<Box<dyn LoadedField>>;

    /// A trainer that takes its steps here. `cancelled` is asked between pieces of what goes to a device.
    ///
    /// # Errors
    /// [`crate::Error::OutOfMemory`] where the field with its optimiser state does not fit, [`crate::Error::Cancelled`], or the device's.
    fn trainer(&self, field: Field, cancelled: &dyn Fn() -> bool) -> Result<Trainer>;

    /// What takes the steps of [`crate::train::train_dvgo`] here.
    ///
    /// # Errors
    /// [`crate::Error::Device`] if the device does not open.
    fn grid_device(&self) -> Result<GridDevice>;

    /// Renders a scene in one volume pass. The result does not depend on the order of `scene.objects`.
    ///
    /// # Errors
    /// [`crate::Error::Cancelled`] once `cancelled` says so (asked between pieces of work), [`crate::Error::Invalid`] for a bad
    /// camera or pose, or the device's.
    fn render(
        &self,
        scene: &Scene<'_>,
        options: &RenderOptions,
        cancelled: &(dyn Fn() -> bool + Sync),
    ) -> Result<RenderedFrame>;
}

/// A field resident on a device. Dropping it frees the device's memory.
pub trait LoadedField: Send + Sync + Debug {
    /// Bytes held on the device.
    fn resident_bytes(&self) -> u64;

    /// Marches rays through the field's occupied space, as [`Field::march_ray`] defines it, and composites each.
    ///
    /// `samples_per_ray` bounds the samples of any one ray. `cancelled` is asked between pieces of at most a few milliseconds' work.
    ///
    /// # Errors
    /// [`crate::Error::Invalid`] if a ray takes more samples than `samples_per_ray`, [`crate::Error::Cancelled`], or the device's.
    fn march(
        &self,
        rays: &[MarchRay],
        samples_per_ray: u32,
        cancelled: &dyn Fn() -> bool,
    ) -> Result<Marched>;
}

/// One ray to march, with a unit direction in the field's local frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MarchRay {
    pub ray: Ray,
    pub range: MarchRange,
}
