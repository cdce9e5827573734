//! WGSL compute kernels of Backlot and what a host must know to run them. Knows no GPU API.
//!
//! `wgsl/` holds libraries (structs, constants and functions, and the bindings that some functions read) and one file per entry point.
//! [`kernels`] lists the entry points with their bindings, [`layout`], [`scene_layout`] and [`grid_layout`] mirror the structs. Both are compared with what
//! naga reads from the WGSL, so neither can drift. The brick's size, workgroup sizes and what is a host's parameter (network width,
//! optimiser constants, how densities are divided) are pipeline overrides; codes and thresholds that only kernels of one field use stand
//! in the WGSL, next to the formula.

pub mod layout;

pub mod scene_layout;

pub mod grid_layout;

mod kernel;

pub mod kernels;

mod training;

mod scene;

mod grid;

pub use kernel::{Access, Binding, Kernel};

/// Nodes along one edge of a brick.
pub const BRICK_SIDE: u32 = 8;

/// Nodes of a brick.
pub const NODES_PER_BRICK: u32 = BRICK_SIDE * BRICK_SIDE * BRICK_SIDE;

/// Numbers that correct a view: log gain, bias, rotation and translation.
pub const VIEW_VALUES: usize = 12;

/// What a view sums on the device: gradients by its [`VIEW_VALUES`], and whether it has had a ray.
pub const VIEW_SUMS: usize = VIEW_VALUES + 1;

/// Bindings over which densities can be split.
pub const DENSITY_PARTS: usize = 4;

/// Values of a 4x4 block of network weights.
pub const BLOCK_FLOATS: usize = 16;

/// Neurons, inputs or samples along one edge of a block.
pub const BLOCK_EDGE: usize = 4;

/// Blocks of the colour network's inputs.
pub const INPUT_BLOCKS: usize = 10;

/// Threads that read together in some kernels: no subgroup may have fewer.
pub const SUBGROUP: u32 = 8;

/// Slots that a workgroup of the four-sample kernels takes at once, past the last slot too.
pub const SLOTS_AT_ONCE: u32 = 4 * FOUR_SAMPLE_THREADS;
pub(crate) const FOUR_SAMPLE_THREADS: u32 = 32;

/// Greatest hidden width, in blocks.
pub const MAX_WIDTH_BLOCKS: usize = 32;

/// Blocks that the kernels declare for each layer, i.e. of the widest network; the third holds the last layer's weights, the second
/// layer's biases and its own.
pub const LAYER_1_BLOCKS: usize = MAX_WIDTH_BLOCKS * INPUT_BLOCKS;
pub const LAYER_2_BLOCKS: usize = MAX_WIDTH_BLOCKS * MAX_WIDTH_BLOCKS;
pub const LAYER_3_BLOCKS: usize = 2 * MAX_WIDTH_BLOCKS + 1;
