//! The compiled kernels of a training step.

use std::sync::Arc;

use backlot_shaders::{Kernel, kernels};

use super::network::width_blocks;
use crate::backend::cpu::view_corrections::ARM_M;
use crate::backend::cpu::{adam, scatter};
use crate::backend::gpu::device::Device;
use crate::backend::gpu::error::Error;
use crate::backend::gpu::field::ResidentField;
use crate::backend::gpu::march::march_kernel;
use crate::backend::gpu::pipeline::Pipeline;
use crate::field::mlp::MlpLayout;

#[derive(Debug)]
pub(super) struct TrainKernels {
    pub(super) correct: Arc<Pipeline>,
    pub(super) march: Arc<Pipeline>,
    pub(super) composite: Arc<Pipeline>,
    pub(super) gather: Arc<Pipeline>,
    pub(super) forward: Arc<Pipeline>,
    pub(super) losses: Arc<Pipeline>,
    pub(super) backward: Arc<Pipeline>,
    pub(super) layer_gradients: [LayerKernel; 3],
    pub(super) scatter: Arc<Pipeline>,
    pub(super) poses: Arc<Pipeline>,
    pub(super) sum: Arc<Pipeline>,
    pub(super) step_bricks: Arc<Pipeline>,
    pub(super) step_network: Arc<Pipeline>,
    pub(super) step_sky: Arc<Pipeline>,
    pub(super) step_views: Arc<Pipeline>,
    pub(super) variation: Arc<Pipeline>,
    pub(super) smooth: Arc<Pipeline>,
}

impl TrainKernels {
    /// The kernels for a field's densities and network, which takes many samples a thread, or one. Each is compiled once a device.
    ///
    /// # Errors
    /// [`Error::Rejected`] where the driver does not take a kernel.
    pub(super) fn new(
        device: &Device,
        shape: &ResidentField,
        network: MlpLayout,
        takes_many: bool,
    ) -> Result<Self, Error> {
        let plain = |kernel: &Kernel| device.pipeline(kernel, &[]);
        let width = [("WIDTH_BLOCKS", width_blocks(network) as f64)];
        let backward = if takes_many {
            kernels::NETWORK_BACKWARD_MANY
        } else {
            kernels::NETWORK_BACKWARD
        };
        let adam = [
            ("BETA_1", f64::from(adam::BETA1)),
            ("BETA_2", f64::from(adam::BETA2)),
            ("EPSILON", f64::from(adam::EPSILON)),
        ];
        let [beta_1, beta_2, epsilon] = adam;
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
            forward: forward(device, network, takes_many, true)?,
            losses: plain(&kernels::RAY_LOSSES)?,
            backward: device.pipeline(&backward, &width)?,
            layer_gradients: layer_gradients(device, takes_many)?,
            scatter: plain(&kernels::SCATTER_GRADIENTS)?,
            poses: plain(&kernels::POSE_GRADIENTS)?,
            sum: plain(&kernels::SUM_STEP)?,
            step_bricks: device.pipeline(&kernels::STEP_BRICKS, &of_nodes)?,
            step_network: device.pipeline(&kernels::STEP_NETWORK, &adam)?,
            step_sky: device.pipeline(&kernels::STEP_SKY, &of_texels)?,
            step_views: device.pipeline(&kernels::STEP_VIEWS, &of_views)?,
            variation: plain(&kernels::BRICK_VARIATION)?,
            smooth: plain(&kernels::SMOOTH_BRICKS)?,
        })
    }
}

/// The colour network's kernel, with activations kept for a backward pass or without.
///
/// # Errors
/// [`Error::Rejected`] where the driver does not take the kernel.
pub(super) fn forward(
    device: &Device,
    network: MlpLayout,
    takes_many: bool,
    keeps_hidden: bool,
) -> Result<Arc<Pipeline>, Error> {
    let kernel = if takes_many {
        kernels::NETWORK_FORWARD_MANY
    } else {
        kernels::NETWORK_FORWARD
    };
    let parameters = [
        ("WIDTH_BLOCKS", width_blocks(network) as f64),
        ("KEEPS_HIDDEN", f64::from(u8::from(keeps_hidden))),
    ];
    device.pipeline(&kernel, &parameters)
}

/// What sums the gradients of one layer's weights.
#[derive(Debug)]
pub(super) struct LayerKernel {
    pub(super) pipeline: Arc<Pipeline>,
    /// Along one edge of a thread's tile of weights.
    pub(super) tile_quads: u32,
}

/// The last layer has too few outputs for wide tiles.
fn layer_gradients(device: &Device, takes_many: bool) -> Result<[LayerKernel; 3], Error> {
    let plain = || -> Result<LayerKernel, Error> {
        Ok(LayerKernel {
            pipeline: device.pipeline(&kernels::LAYER_GRADIENTS, &[])?,
            tile_quads: backlot_shaders::TILE_QUADS,
        })
    };
    if !takes_many {
        return Ok([plain()?, plain()?, plain()?]);
    }
    let wide = || -> Result<LayerKernel, Error> {
        Ok(LayerKernel {
            pipeline: device.pipeline(&kernels::LAYER_GRADIENTS_WIDE, &[])?,
            tile_quads: backlot_shaders::WIDE_TILE_QUADS,
        })
    };
    Ok([wide()?, wide()?, plain()?])
}
