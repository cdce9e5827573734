//! The kernels of merged rendering that do not depend on the field.

use std::sync::Arc;

use backlot_shaders::{Kernel, kernels};

use crate::backend::gpu::device::Device;
use crate::backend::gpu::error::Error;
use crate::backend::gpu::network::width_blocks;
use crate::backend::gpu::pipeline::Pipeline;
use crate::field::mlp::MlpLayout;

#[derive(Debug)]
pub(super) struct SceneKernels {
    pub(super) eye_rays: Arc<Pipeline>,
    pub(super) object_samples: Arc<Pipeline>,
    pub(super) slots: Arc<Pipeline>,
    pub(super) colors: Arc<Pipeline>,
    pub(super) sky: Arc<Pipeline>,
}

impl SceneKernels {
    /// # Errors
    /// [`Error::Rejected`] where the driver does not take a kernel, or binds fewer buffers than it has.
    pub(super) fn new(device: &Device) -> Result<Self, Error> {
        let compiled = |kernel: &Kernel| device.pipeline(kernel, &[]);
        // Those of whole fields are compiled now as well: an adapter that cannot take them must not be chosen.
        for kernel in [
            &kernels::MARCH_DENSITY,
            &kernels::MERGE_SCENE,
            &kernels::SCENE_FEATURES,
        ] {
            compiled(kernel)?;
        }
        Ok(Self {
            eye_rays: compiled(&kernels::EYE_RAYS)?,
            object_samples: compiled(&kernels::OBJECT_SAMPLES)?,
            slots: compiled(&kernels::SCENE_SLOTS)?,
            colors: compiled(&kernels::SCENE_COLORS)?,
            sky: compiled(&kernels::SCENE_SKY)?,
        })
    }
}

/// The colour network's kernel for a width.
pub(super) fn network(device: &Device, layout: MlpLayout) -> Result<Arc<Pipeline>, Error> {
    let width = [("WIDTH_BLOCKS", width_blocks(layout) as f64)];
    device.pipeline(&kernels::SCENE_NETWORK, &width)
}
