//! WGSL compute kernels of Backlot and what a host must know to run them. Knows no GPU API.
//!
//! `wgsl/` holds libraries (functions only) and one file per entry point. [`kernels`] lists the entry points with their
//! bindings, [`layout`] and [`scene_layout`] mirror the structs. Both are compared with what naga reads from the WGSL, so neither can drift;
//! constants that host and kernel share are pipeline overrides filled from here, so there is no second copy of them.

pub mod layout;

pub mod scene_layout;

mod kernel;

pub mod kernels;

mod training;

mod scene;

pub use kernel::{Access, Binding, Kernel};

/// Nodes along one edge of a brick.
pub const BRICK_SIDE: u32 = 8;

/// Bindings over which densities can be split.
pub const DENSITY_PARTS: usize = 4;

/// Values of a 4x4 block of network weights.
pub const BLOCK_FLOATS: usize = 16;

/// Neurons, inputs or samples along one edge of a block.
pub const BLOCK_EDGE: usize = 4;

/// Blocks of the colour network's inputs.
pub const INPUT_BLOCKS: usize = 10;

/// Greatest hidden width, in blocks.
pub const MAX_WIDTH_BLOCKS: usize = 32;

/// Blocks that the kernels declare for each layer, i.e. of the widest network; the third holds the last layer's weights, the second
/// layer's biases and its own.
pub const LAYER_1_BLOCKS: usize = MAX_WIDTH_BLOCKS * INPUT_BLOCKS;
pub const LAYER_2_BLOCKS: usize = MAX_WIDTH_BLOCKS * MAX_WIDTH_BLOCKS;
pub const LAYER_3_BLOCKS: usize = 2 * MAX_WIDTH_BLOCKS + 1;
