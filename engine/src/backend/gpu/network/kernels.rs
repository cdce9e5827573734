//! The compiled kernels of a colour network in training.

use std::sync::Arc;

use backlot_shaders::layout::LayerParams;
use backlot_shaders::{BLOCK_FLOATS, SUBGROUP, kernels};

use super::bindings::NetworkBindings;
use super::{gradient_tiles, layer_params, weight_blocks, width_blocks};
use crate::backend::cpu::adam;
use crate::backend::gpu::device::Device;
use crate::backend::gpu::error::Error;
use crate::backend::gpu::free_groups;
use crate::backend::gpu::pipeline::{Groups, Pipeline};
use crate::backend::gpu::sequence::Sequence;
use crate::field::mlp::MlpLayout;

#[derive(Debug)]
pub(in crate::backend::gpu) struct NetworkKernels {
    network: MlpLayout,
    pub(in crate::backend::gpu) forward: Arc<Pipeline>,
    pub(super) backward: Arc<Pipeline>,
    layer_gradients: LayerKernels,
    pub(super) step: Arc<Pipeline>,
}

impl NetworkKernels {
    /// The kernels for a network, which take four samples a thread, or one. Each is compiled once a device.
    ///
    /// # Errors
    /// [`Error::Rejected`] where the driver does not take a kernel.
    pub(in crate::backend::gpu) fn new(
        device: &Device,
        network: MlpLayout,
        takes_four: bool,
    ) -> Result<Self, Error> {
        let width = [("WIDTH_BLOCKS", width_blocks(network) as f64)];
        let backward = if takes_four {
            kernels::NETWORK_BACKWARD_FOUR
        } else {
            kernels::NETWORK_BACKWARD
        };
        Ok(Self {
            network,
            forward: forward(device, network, takes_four, true)?,
            backward: device.pipeline(&backward, &width)?,
            layer_gradients: LayerKernels::new(device, takes_four)?,
            step: device.pipeline(&kernels::STEP_NETWORK, &adam_parameters())?,
        })
    }

    /// From the colours' gradients to those of inputs and weights, samples divided into `shares`.
    pub(in crate::backend::gpu) fn run_backward<'a>(
        &'a self,
        device: &Device,
        sequence: &mut Sequence<'a>,
        bindings: &'a NetworkBindings,
        shares: u32,
    ) {
        sequence.run(&self.backward, &bindings.backward, free_groups(device));
        let layers = layer_params(self.network);
        for (layer, bound) in layers.iter().zip(&bindings.layer_gradients) {
            let groups = self.layer_groups(device, layer, shares);
            sequence.run(self.layer_gradients(layer), bound, groups);
        }
    }

    /// Sums the shares of the weights' gradients, moves the weights and clears the sums.
    pub(in crate::backend::gpu) fn run_step<'a>(
        &'a self,
        device: &Device,
        sequence: &mut Sequence<'a>,
        bindings: &'a NetworkBindings,
    ) {
        let weights = weight_blocks(self.network) * BLOCK_FLOATS;
        let per_weight = self.step.groups(device, weights as u32);
        sequence.run(&self.step, &bindings.step, per_weight);
    }

    /// What sums the gradients of a layer's weights.
    pub(super) fn layer_gradients(&self, layer: &LayerParams) -> &Pipeline {
        match &self.layer_gradients {
            LayerKernels::Alone(kernel) => kernel,
            LayerKernels::Shared { inputs, .. } if layer.output_quads == 1 => inputs,
            LayerKernels::Shared { outputs, .. } => outputs,
        }
    }

    fn layer_groups(&self, device: &Device, layer: &LayerParams, shares: u32) -> Groups {
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

/// Parameters of kernels that take Adam's steps.
pub(in crate::backend::gpu) fn adam_parameters() -> [(&'static str, f64); 3] {
    [
        ("BETA_1", f64::from(adam::BETA1)),
        ("BETA_2", f64::from(adam::BETA2)),
        ("EPSILON", f64::from(adam::EPSILON)),
    ]
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

/// The colour network's kernel, with activations kept for a backward pass or without.
///
/// # Errors
/// [`Error::Rejected`] where the driver does not take the kernel.
pub(in crate::backend::gpu) fn forward(
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
