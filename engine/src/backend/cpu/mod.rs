//! The CPU backend: needs nothing installed, and is the oracle of the GPU's kernels.
//!
//! Marching is plain scalar code that the compiler neither reorders nor fuses, so its results are the same on every machine.
//! Training and colours run vector code chosen at run time ([`Simd`]), with rayon over chunks of rays and over bricks.

pub(crate) mod adam;
pub(crate) mod bf16;
mod chunk;
pub(crate) mod colorist;
#[doc(hidden)]
pub mod kernels;
pub(crate) mod lanes;
mod march;
mod matmul;
#[cfg(test)]
pub(in crate::backend) mod mirror;
pub(crate) mod mlp;
pub(crate) mod prefetch;
mod ray_losses;
pub(in crate::backend) mod scatter;
pub(crate) mod simd;
#[cfg(all(test, feature = "gpu"))]
mod stage_record;
#[cfg(test)]
pub(in crate::backend) mod tests;
mod trainer;
mod variation;
pub(in crate::backend) mod view_corrections;

pub(crate) use chunk::NO_SLOT;
pub use simd::Simd;
pub use trainer::CpuTrainer;
pub use view_corrections::{PoseCorrection, ViewCorrection};

use std::sync::Arc;

use super::{Backend, GridDevice, LoadedField, Trainer};
use crate::Result;
use crate::field::Field;
use crate::scene::{self, RenderOptions, RenderedFrame, Scene};

/// The processor this runs on.
#[derive(Clone, Copy, Debug, Default)]
pub struct CpuBackend;

impl Backend for CpuBackend {
    fn name(&self) -> &'static str {
        "cpu"
    }

    fn device(&self) -> String {
        format!(
            "{} with {} threads",
            std::env::consts::ARCH,
            rayon::current_num_threads()
        )
    }

    fn load(&self, field: &Arc<Field>) -> Result<Box<dyn LoadedField>> {
        Ok(Box::new(march::CpuField::new(Arc::clone(field))))
    }

    fn trainer(&self, field: Field, _: &dyn Fn() -> bool) -> Result<Trainer> {
        Ok(Trainer::on_cpu(CpuTrainer::fastest(field)))
    }

    fn grid_device(&self) -> Result<GridDevice> {
        Ok(GridDevice::cpu())
    }

    fn render(
        &self,
        scene: &Scene<'_>,
        options: &RenderOptions,
        cancelled: &(dyn Fn() -> bool + Sync),
    ) -> Result<RenderedFrame> {
        scene::render(scene, options, cancelled)
    }
}
