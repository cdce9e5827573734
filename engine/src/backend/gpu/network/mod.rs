//! The colour network in the form that kernels read: 4x4 blocks, layer after layer.

pub(super) mod kernels;

pub(super) mod batch;

pub(super) mod bindings;

pub(super) use batch::NetworkBatch;
pub(super) use bindings::{NetworkBindings, NetworkBuffers};
pub(super) use kernels::NetworkKernels;

use backlot_shaders::layout::LayerParams;
use backlot_shaders::{
    BLOCK_EDGE, BLOCK_FLOATS, INPUT_BLOCKS, LAYER_1_BLOCKS, LAYER_2_BLOCKS, LAYER_3_BLOCKS,
};
use wgpu::BufferUsages;

use crate::backend::gpu::buffer::Buffer;
use crate::backend::gpu::device::Device;
use crate::backend::gpu::error::Error;
use crate::backend::gpu::sequence::Sequence;
use crate::field::mlp::{MLP_OUTPUTS, MlpLayout};
use crate::field::{ColorMlp, FEATURES};

/// Inputs before the sines of the direction, and before its cosines.
const SINES_AT: usize = FEATURES + 3;
const COSINES_AT: usize = SINES_AT + 12;
const OCTAVES: usize = 4;

pub(in crate::backend::gpu) type Block = [f32; BLOCK_FLOATS];

/// Weights on the device, and copies of the layers where kernels read them as constants.
#[derive(Debug)]
pub(in crate::backend::gpu) struct ResidentNetwork {
    layout: MlpLayout,
    pub(in crate::backend::gpu) weights: Buffer<Block>,
    pub(in crate::backend::gpu) layers: [Buffer<Block>; 3],
}

impl ResidentNetwork {
    pub(in crate::backend::gpu) fn upload(device: &Device, mlp: &ColorMlp) -> Result<Self, Error> {
        let blocks = pack(mlp);
        let layer = |label, len| Buffer::zeroed(device, label, len, BufferUsages::UNIFORM);
        let network = Self {
            layout: mlp.layout(),
            weights: Buffer::from_slice(device, "network", &blocks, BufferUsages::STORAGE)?,
            layers: [
                layer("network layer 1", LAYER_1_BLOCKS)?,
                layer("network layer 2", LAYER_2_BLOCKS)?,
                layer("network layer 3", LAYER_3_BLOCKS)?,
            ],
        };
        let mut sequence = Sequence::new(device, "network upload");
        network.spread(&mut sequence);
        sequence.submit()?;
        Ok(network)
    }

    fn layout(&self) -> MlpLayout {
        self.layout
    }

    /// Copies the weights to the layers.
    pub(in crate::backend::gpu) fn spread<'a>(&'a self, sequence: &mut Sequence<'a>) {
        let mut offset = 0;
        for (layer, blocks) in self.layers.iter().zip(layer_blocks(self.layout)) {
            let bytes = (blocks * size_of::<Block>()) as u64;
            sequence.copy(&self.weights.raw, offset, &layer.raw, bytes);
            offset += bytes;
        }
    }

    /// Copies the weights back to the host.
    pub(in crate::backend::gpu) fn fetch(
        &self,
        device: &Device,
        mlp: &mut ColorMlp,
    ) -> Result<(), Error> {
        let blocks = self.weights.read(device, weight_blocks(self.layout))?;
        unpack(&blocks, self.layout, mlp.parameters_mut());
        Ok(())
    }
}

/// Hidden width in blocks, the kernels' parameter.
pub(in crate::backend::gpu) fn width_blocks(layout: MlpLayout) -> usize {
    layout.width / BLOCK_EDGE
}

fn layer_blocks(layout: MlpLayout) -> [usize; 3] {
    let width = width_blocks(layout);
    [width * INPUT_BLOCKS, width * width, 2 * width + 1]
}

/// Blocks of all layers.
pub(in crate::backend::gpu) fn weight_blocks(layout: MlpLayout) -> usize {
    layer_blocks(layout).iter().sum()
}

/// The layers as [`backlot_shaders::kernels::LAYER_GRADIENTS`] takes them, without shares.
pub(in crate::backend::gpu) fn layer_params(layout: MlpLayout) -> [LayerParams; 3] {
    let width = width_blocks(layout) as u32;
    let [first, second, _] = layer_blocks(layout).map(|blocks| blocks as u32);
    let third_at = first + second;
    let weight_blocks = weight_blocks(layout) as u32;
    let of = |input_quads, output_quads, first_block, first_bias| LayerParams {
        input_quads,
        output_quads,
        shares: 0,
        weight_blocks,
        first_block,
        first_bias,
    };
    [
        of(INPUT_BLOCKS as u32, width, 0, 0),
        of(width, width, first, third_at + width),
        of(width, 1, third_at, third_at + 2 * width),
    ]
}

/// Tiles of 4 x 4 blocks that cover a layer's weights.
fn gradient_tiles(layer: &LayerParams) -> u32 {
    layer.input_quads.div_ceil(4) * layer.output_quads.div_ceil(4)
}

fn pack(mlp: &ColorMlp) -> Vec<Block> {
    let parameters = mlp.parameters();
    let values = places(mlp.layout()).map(|place| place.map_or(0.0, |at| parameters[at]));
    let values: Vec<f32> = values.collect();
    let (blocks, rest) = values.as_chunks();
    assert!(rest.is_empty(), "layers are whole blocks");
    blocks.to_vec()
}

/// Puts the blocks' values where [`ColorMlp::parameters`] has them.
pub(in crate::backend::gpu) fn unpack(blocks: &[Block], layout: MlpLayout, out: &mut [f32]) {
    for (place, value) in places(layout).zip(blocks.as_flattened()) {
        if let Some(at) = place {
            out[at] = *value;
        }
    }
}

/// Which parameter of [`ColorMlp`] each value is, in order; `None` for padding.
fn places(layout: MlpLayout) -> impl Iterator<Item = Option<usize>> {
    let width = layout.width;
    let blocks = width_blocks(layout);
    let cells = || (0..BLOCK_FLOATS).map(|cell| (cell / BLOCK_EDGE, cell % BLOCK_EDGE));
    let first = (0..blocks * INPUT_BLOCKS).flat_map(move |block| {
        cells().map(move |(column, row)| {
            let neuron = block / INPUT_BLOCKS * BLOCK_EDGE + row;
            Some(match input(block % INPUT_BLOCKS, column) {
                Some(input) => layout.w1().start + input * width + neuron,
                None => layout.b1().start + neuron,
            })
        })
    });
    let second = (0..blocks * blocks).flat_map(move |block| {
        cells().map(move |(column, row)| {
            let from = block % blocks * BLOCK_EDGE + column;
            Some(layout.w2().start + from * width + block / blocks * BLOCK_EDGE + row)
        })
    });
    let third = (0..blocks).flat_map(move |block| {
        cells().map(move |(column, row)| {
            Some(layout.w3().start + (block * BLOCK_EDGE + column) * MLP_OUTPUTS + row)
        })
    });
    // Biases are first columns.
    let biases = (0..=blocks).flat_map(move |block| {
        let first = if block == blocks {
            layout.b3().start
        } else {
            layout.b2().start + block * BLOCK_EDGE
        };
        cells().map(move |(column, row)| (column == 0).then_some(first + row))
    });
    first.chain(second).chain(third).chain(biases)
}

/// The network's input in a column of an input block; `None` for the constant 1.
fn input(block: usize, column: usize) -> Option<usize> {
    match block {
        0..3 => Some(block * BLOCK_EDGE + column),
        3 => (column < 3).then_some(FEATURES + column),
        4..7 => Some(SINES_AT + (block - 4) * OCTAVES + column),
        _ => Some(COSINES_AT + (block - 7) * OCTAVES + column),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn packing_keeps_every_parameter_once() {
        for width in ColorMlp::WIDTHS {
            let layout = MlpLayout { width };
            let parameters = (1..=layout.len()).map(|p| p as f32).collect();
            let mlp = ColorMlp::from_parameters(width, parameters).unwrap();
            let blocks = pack(&mlp);
            assert_eq!(blocks.len(), weight_blocks(layout));
            let stored = blocks.as_flattened().iter().filter(|w| **w != 0.0);
            assert_eq!(stored.count(), layout.len(), "width {width}");
            let mut back = vec![0.0; layout.len()];
            unpack(&blocks, layout, &mut back);
            assert_eq!(back, mlp.parameters());
        }
    }
}
