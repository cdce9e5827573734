//! The compiled kernels of a training step.

use backlot_shaders::{Kernel, kernels};

use super::network::width_blocks;
use crate::backend::gpu::device::Device;
use crate::backend::gpu::error::Error;
use crate::backend::gpu::pipeline::Pipeline;
use crate::field::mlp::MlpLayout;

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
}

impl TrainKernels {
    pub(super) fn new(device: &Device, network: MlpLayout) -> Result<Self, Error> {
        let plain = |kernel: &Kernel| Pipeline::new(device, kernel);
        let width = [("WIDTH_BLOCKS", width_blocks(network) as f64)];
        let wide = |kernel: &Kernel| Pipeline::with(device, kernel, &width);
        Ok(Self {
            march: plain(&kernels::MARCH_DENSITY)?,
            composite: plain(&kernels::COMPOSITE_SAMPLES)?,
            gather: plain(&kernels::GATHER_INPUTS)?,
            forward: wide(&kernels::NETWORK_FORWARD)?,
            losses: plain(&kernels::RAY_LOSSES)?,
            backward: wide(&kernels::NETWORK_BACKWARD)?,
            layer_gradients: plain(&kernels::LAYER_GRADIENTS)?,
            scatter: plain(&kernels::SCATTER_GRADIENTS)?,
            sum: plain(&kernels::SUM_STEP)?,
            step_bricks: plain(&kernels::STEP_BRICKS)?,
            step_network: plain(&kernels::STEP_NETWORK)?,
            step_sky: plain(&kernels::STEP_SKY)?,
        })
    }
}
