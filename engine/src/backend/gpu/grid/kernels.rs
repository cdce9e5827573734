//! The compiled kernels of a step on a dense grid.

use std::sync::Arc;

use backlot_shaders::{Kernel, kernels};

use crate::backend::gpu::device::Device;
use crate::backend::gpu::error::Error;
use crate::backend::gpu::network::NetworkKernels;
use crate::backend::gpu::network::kernels::adam_parameters;
use crate::backend::gpu::pipeline::Pipeline;
use crate::field::mlp::MlpLayout;
use crate::train::dvgo::LIVELY_STEPS;

#[derive(Debug)]
pub(super) struct GridKernels {
    pub(super) march: Arc<Pipeline>,
    /// The network's inputs, or colours at once where there is no network.
    pub(super) gather: Arc<Pipeline>,
    pub(super) losses: Arc<Pipeline>,
    pub(super) network: Option<NetworkKernels>,
    pub(super) scatter: Arc<Pipeline>,
    pub(super) sum: Arc<Pipeline>,
    pub(super) wake: Arc<Pipeline>,
    pub(super) step_density: Arc<Pipeline>,
    pub(super) step_quad: Arc<Pipeline>,
}

impl GridKernels {
    /// The kernels for nodes of so many quads of colour values. Each is compiled once a device.
    ///
    /// # Errors
    /// [`Error::Rejected`] where the driver does not take a kernel.
    pub(super) fn new(
        device: &Device,
        quads: usize,
        network: Option<MlpLayout>,
    ) -> Result<Self, Error> {
        let plain = |kernel: &Kernel| device.pipeline(kernel, &[]);
        let [beta_1, beta_2, epsilon] = adam_parameters();
        let step = |values: f64| {
            let parameters = [beta_1, beta_2, epsilon, ("VALUES_PER_NODE", values)];
            device.pipeline(&kernels::STEP_GRID, &parameters)
        };
        let is_direct = f64::from(u8::from(network.is_none()));
        let lively = f64::from(LIVELY_STEPS);
        // Reading a weight is broadcast for free on a GPU, and dearer than using it in software.
        let of_network = |network| NetworkKernels::new(device, network, device.reads_together());
        Ok(Self {
            march: plain(&kernels::MARCH_GRID)?,
            gather: plain(match network {
                Some(_) => &kernels::GRID_INPUTS,
                None => &kernels::GRID_COLORS,
            })?,
            losses: device.pipeline(&kernels::GRID_LOSSES, &[("IS_DIRECT", is_direct)])?,
            network: network.map(of_network).transpose()?,
            scatter: device.pipeline(&kernels::SCATTER_GRID, &[("QUADS", quads as f64)])?,
            sum: plain(&kernels::SUM_STEP)?,
            wake: device.pipeline(&kernels::WAKE_BRICKS, &[("LIVELY_STEPS", lively)])?,
            step_density: step(1.0)?,
            step_quad: step(4.0)?,
        })
    }
}
