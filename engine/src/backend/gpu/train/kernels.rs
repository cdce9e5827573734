//! The compiled kernels of a training step.

use std::sync::Arc;

use backlot_shaders::layout::LayerParams;
use backlot_shaders::{Kernel, SUBGROUP, kernels};

use super::network::{gradient_tiles, width_blocks};
use crate::backend::cpu::view_corrections::ARM_M;
use crate::backend::cpu::{adam, scatter};
use crate::backend::gpu::device::Device;
use crate::backend::gpu::error::Error;
use crate::backend::gpu::field::ResidentField;
use crate::backend::gpu::march::march_kernel;
use crate::backend::gpu::pipeline::{Groups, Pipeline};
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
    layer_gradients: LayerKernels,
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
        let width = [("WIDTH_BLOCKS", width_blocks(network) as f64)];
        let backward = if takes_four {
            kernels::NETWORK_BACKWARD_FOUR
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
            forward: forward(device, network, takes_four, true)?,
            losses: plain(&kernels::RAY_LOSSES)?,
            backward: device.pipeline(&backward, &width)?,
            layer_gradients: LayerKernels::new(device, takes_four)?,
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

/// What sums the gradients of weights.
#[derive(Debug)]
enum LayerKernels {
    /// One tile of weights a thread.
    Alone(Arc<Pipeline>),
    /// Threads read together: layers whose outputs are divided among them, and the last one, which has too few.
    Shared {
        outputs: Arc<Pipeline>,
        inputs: Arc<Pipeline>,
    },
}

impl LayerKernels {
    fn new(device: &Device, takes_four: bool) -> Result<Self, Error> {
        if !takes_four {
            return Ok(Self::Alone(
                device.pipeline(&kernels::LAYER_GRADIENTS, &[])?,
            ));
        }
        let shared = |takes_inputs: bool| {
            let parameters = [("TAKES_INPUTS", f64::from(u8::from(takes_inputs)))];
            device.pipeline(&kernels::LAYER_GRADIENTS_SHARED, &parameters)
        };
        Ok(Self::Shared {
            outputs: shared(false)?,
            inputs: shared(true)?,
        })
    }
}

impl TrainKernels {
    /// What sums the gradients of a layer's weights.
    pub(super) fn layer_gradients(&self, layer: &LayerParams) -> &Pipeline {
        match &self.layer_gradients {
            LayerKernels::Alone(kernel) => kernel,
            LayerKernels::Shared { inputs, .. } if layer.output_quads == 1 => inputs,
            LayerKernels::Shared { outputs, .. } => outputs,
        }
    }

    /// Its workgroups, for samples divided into `shares`.
    pub(super) fn layer_groups(&self, device: &Device, layer: &LayerParams, shares: u32) -> Groups {
        match &self.layer_gradients {
            LayerKernels::Alone(kernel) => kernel.groups(device, gradient_tiles(layer) * shares),
            LayerKernels::Shared { .. } => {
                let others = if layer.output_quads == 1 {
                    1
                } else {
                    layer.input_quads
                };
                Groups {
                    x: others.div_ceil(SUBGROUP) * shares,
                    y: 1,
                }
            }
        }
    }
}

/// The colour network's kernel, with activations kept for a backward pass or without.
///
/// # Errors
/// [`Error::Rejected`] where the driver does not take the kernel.
pub(super) fn forward(
    device: &Device,
    network: MlpLayout,
    takes_four: bool,
    keeps_hidden: bool,
) -> Result<Arc<Pipeline>, Error> {
    let kernel = if takes_four {
        kernels::NETWORK_FORWARD_FOUR
    } else {
        kernels::NETWORK_FORWARD
    };
    let parameters = [
        ("WIDTH_BLOCKS", width_blocks(network) as f64),
        ("KEEPS_HIDDEN", f64::from(u8::from(keeps_hidden))),
    ];
    device.pipeline(&kernel, &parameters)
}
