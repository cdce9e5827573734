//! The compiled kernels of a training step.

use std::sync::Arc;

use backlot_shaders::{Kernel, kernels};

use crate::backend::cpu::view_corrections::ARM_M;
use crate::backend::cpu::{adam, scatter};
use crate::backend::gpu::device::Device;
use crate::backend::gpu::error::Error;
use crate::backend::gpu::field::ResidentField;
use crate::backend::gpu::march::march_kernel;
use crate::backend::gpu::network::NetworkKernels;
use crate::backend::gpu::network::kernels::adam_parameters;
use crate::backend::gpu::pipeline::Pipeline;
use crate::field::mlp::MlpLayout;

#[derive(Debug)]
pub(super) struct TrainKernels {
    pub(super) correct: Arc<Pipeline>,
    pub(super) march: Arc<Pipeline>,
    pub(super) composite: Arc<Pipeline>,
    pub(super) gather: Arc<Pipeline>,
    pub(super) network: NetworkKernels,
    pub(super) losses: Arc<Pipeline>,
    pub(super) scatter: Arc<Pipeline>,
    pub(super) poses: Arc<Pipeline>,
    pub(super) sum: Arc<Pipeline>,
    pub(super) step_bricks: Arc<Pipeline>,
    pub(super) step_sky: Arc<Pipeline>,
    pub(super) step_views: Arc<Pipeline>,
    pub(super) variation: Arc<Pipeline>,
    pub(super) smooth: Arc<Pipeline>,
}

impl TrainKernels {
    /// The kernels for a field's densities and network, which takes four samples a thread, or one. Each is compiled once a device.
    ///
    /// # Errors
    /// [`Error::Rejected`] where the driver does not take a kernel.
    pub(super) fn new(
        device: &Device,
        shape: &ResidentField,
        network: MlpLayout,
        takes_four: bool,
    ) -> Result<Self, Error> {
        let plain = |kernel: &Kernel| device.pipeline(kernel, &[]);
        let [beta_1, beta_2, epsilon] = adam_parameters();
        let of_views = [beta_1, beta_2, epsilon, ("ARM_M", f64::from(ARM_M))];
        let of_nodes = [
            ("DECAY", f64::from(scatter::DECAY)),
            ("EPSILON", f64::from(scatter::EPSILON)),
        ];
        let of_texels = [("DECAY", f64::from(adam::SKY_DECAY))];
        Ok(Self {
            correct: plain(&kernels::CORRECT_RAYS)?,
            march: march_kernel(device, shape)?,
            composite: plain(&kernels::COMPOSITE_SAMPLES)?,
            gather: plain(&kernels::GATHER_INPUTS)?,
            network: NetworkKernels::new(device, network, takes_four)?,
            losses: plain(&kernels::RAY_LOSSES)?,
            scatter: plain(&kernels::SCATTER_GRADIENTS)?,
            poses: plain(&kernels::POSE_GRADIENTS)?,
            sum: plain(&kernels::SUM_STEP)?,
            step_bricks: device.pipeline(&kernels::STEP_BRICKS, &of_nodes)?,
            step_sky: device.pipeline(&kernels::STEP_SKY, &of_texels)?,
            step_views: device.pipeline(&kernels::STEP_VIEWS, &of_views)?,
            variation: plain(&kernels::BRICK_VARIATION)?,
            smooth: plain(&kernels::SMOOTH_BRICKS)?,
        })
    }
}
