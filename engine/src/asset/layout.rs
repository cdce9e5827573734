//! The stored form of an asset, version 1.
//!
//! A zstd frame around one safetensors file, so that `zstd -d` and any safetensors reader open it:
//!
//! | tensor | type | shape | meaning |
//! |---|---|---|---|
//! | `level{l}.positions` | U16 | n, 3 | brick positions (x, y, z) of level l, coarse to fine |
//! | `level{l}.density` | F16 | n, 512 | raw density; node (x, y, z) of a brick at (z * 8 + y) * 8 + x |
//! | `level{l}.features` | F16 | n, 512, 12 | colour features |
//! | `mlp` | F32 | k | colour network, input-major: w1, b1, w2, b2, w3, b3 |
//! | `sky{g}` | F16 | height, width, 3 | colour logits of sky grid g, coarse to fine; absent for objects |
//! | `occupancy.blocks` | U16 | m, 3 | block positions |
//! | `occupancy.masks` | U64 | m, 8 | word z, bit y * 8 + x |
//! | `occupancy.steps` | F32 | m | step in metres |
//!
//! The safetensors metadata has two JSON texts: `backlot.header` ([`super::AssetHeader`]) and `backlot.field` ([`FieldLayout`]).
//! Bricks that are zero in f16 are not stored: a missing brick contributes 0 anyway.

use serde::{Deserialize, Serialize};

use crate::field::DensityActivation;

pub(super) const HEADER_KEY: &str = "backlot.header";
pub(super) const FIELD_KEY: &str = "backlot.field";

/// Most bytes a payload may unpack to: twice the largest field a 24 GiB machine trains.
pub(super) const MAX_UNPACKED_BYTES: u64 = 4 << 30;
/// Levels of a field; voxel sizes at least halve, so 16 span a factor of 32,768.
pub(super) const MAX_LEVELS: usize = 16;
pub(super) const MAX_SKY_GRIDS: usize = 8;

/// What the tensors do not say themselves.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct FieldLayout {
    /// Lower and upper corner of the box, metres.
    pub bounds_m: [[f32; 3]; 2],
    pub levels: Vec<GridLayout>,
    pub activation: DensityActivation,
    pub mlp_width: usize,
    pub sky_grids: usize,
    pub occupancy: GridLayout,
    pub step_growth: f32,
}

/// A grid of bricks or blocks.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct GridLayout {
    /// Edge of a voxel or cell in metres.
    pub cell_m: f32,
    pub origin_m: [f32; 3],
    /// Bricks or blocks per axis.
    pub extent: [u32; 3],
}
