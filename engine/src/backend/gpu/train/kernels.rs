//! The compiled kernels of a training step.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

use backlot_shaders::{Kernel, kernels};

use super::network::width_blocks;
use crate::backend::gpu::device::Device;
use crate::backend::gpu::error::Error;
use crate::backend::gpu::pipeline::Pipeline;
use crate::field::mlp::MlpLayout;

/// Compiled kernels by the width of the network, shared by all trainers of a device: drivers take seconds to compile some.
#[derive(Clone, Debug, Default)]
pub(in crate::backend::gpu) struct KernelCache {
    by_width: Arc<Mutex<BTreeMap<usize, Arc<TrainKernels>>>>,
}

impl KernelCache {
    /// The kernels for a network, compiled on first use.
    ///
    /// # Errors
    /// [`Error::Rejected`] where the driver does not take a kernel.
    pub(super) fn get(
        &self,
        device: &Device,
        network: MlpLayout,
    ) -> Result<Arc<TrainKernels>, Error> {
        // Only whole sets are ever stored.
        let mut by_width = self.by_width.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(kernels) = by_width.get(&network.width) {
            return Ok(Arc::clone(kernels));
        }
        // Reading a weight is broadcast for free on a GPU, and as dear as using it in software.
        let kernels = TrainKernels::new(device, network, device.is_software())?;
        let kernels = Arc::new(kernels);
        by_width.insert(network.width, Arc::clone(&kernels));
        Ok(kernels)
    }
}

#[derive(Debug)]
pub(super) struct TrainKernels {
    pub(super) march: Pipeline,
    pub(super) composite: Pipeline,
    pub(super) gather: Pipeline,
    pub(super) forward: Pipeline,
    pub(super) losses: Pipeline,
    pub(super) backward: Pipeline,
    pub(super) layer_gradients: Pipeline,
    pub(super) scatter: Pipeline,
    pub(super) sum: Pipeline,
    pub(super) step_bricks: Pipeline,
    pub(super) step_network: Pipeline,
    pub(super) step_sky: Pipeline,
    pub(super) variation: Pipeline,
    pub(super) smooth: Pipeline,
}

impl TrainKernels {
    /// With four samples a thread in the colour network, or one.
    pub(super) fn new(
        device: &Device,
        network: MlpLayout,
        takes_four: bool,
    ) -> Result<Self, Error> {
        let plain = |kernel: &Kernel| Pipeline::new(device, kernel);
        let width = [("WIDTH_BLOCKS", width_blocks(network) as f64)];
        let wide = |kernel: &Kernel| Pipeline::with(device, kernel, &width);
        let (forward, backward) = if takes_four {
            (
                kernels::NETWORK_FORWARD_FOUR,
                kernels::NETWORK_BACKWARD_FOUR,
            )
        } else {
            (kernels::NETWORK_FORWARD, kernels::NETWORK_BACKWARD)
        };
        Ok(Self {
            march: plain(&kernels::MARCH_DENSITY)?,
            composite: plain(&kernels::COMPOSITE_SAMPLES)?,
            gather: plain(&kernels::GATHER_INPUTS)?,
            forward: wide(&forward)?,
            losses: plain(&kernels::RAY_LOSSES)?,
            backward: wide(&backward)?,
            layer_gradients: plain(&kernels::LAYER_GRADIENTS)?,
            scatter: plain(&kernels::SCATTER_GRADIENTS)?,
            sum: plain(&kernels::SUM_STEP)?,
            step_bricks: plain(&kernels::STEP_BRICKS)?,
            step_network: plain(&kernels::STEP_NETWORK)?,
            step_sky: plain(&kernels::STEP_SKY)?,
            variation: plain(&kernels::BRICK_VARIATION)?,
            smooth: plain(&kernels::SMOOTH_BRICKS)?,
        })
    }
}
