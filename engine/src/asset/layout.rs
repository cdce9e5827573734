//! The stored form of an asset, version 2 (docs/asset-format.md).
//!
//! A zstd frame around one safetensors file, so that `zstd -d` and any safetensors reader open it:
//!
//! | tensor | type | shape | meaning |
//! |---|---|---|---|
//! | `level{l}.positions` | U16 | n, 3 | brick positions (x, y, z) of level l, coarse to fine |
//! | `level{l}.density` | U8 | 2, n, 512 | raw density in steps, i16: low bytes, then high bytes; node (x, y, z) at (z * 8 + y) * 8 + x |
//! | `level{l}.features` | I8 | n, 512, 12 | colour features in steps of their scale |
//! | `level{l}.feature_scales` | F16 | n, 12 | a step of each brick and channel |
//! | `mlp` | F32 | k | colour network, input-major: w1, b1, w2, b2, w3, b3 |
//! | `sky{g}` | F16 | height, width, 3 | colour logits of sky grid g, coarse to fine; absent for objects |
//! | `occupancy.blocks` | U16 | m, 3 | block positions |
//! | `occupancy.masks` | U64 | m, 8 | word z, bit y * 8 + x |
//! | `occupancy.steps` | F32 | m | step in metres |
//!
//! The safetensors metadata has two JSON texts: `backlot.header` ([`super::AssetHeader`]) and `backlot.field` ([`FieldLayout`]).
//! Bricks whose steps are all 0 are not stored: a missing brick contributes 0 anyway. Version 1 had `density` F16 n, 512 and
//! `features` F16 n, 512, 12 and no scales; it is still read.

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
    /// Raw density of one step; absent in version 1, whose densities are f16.
    #[serde(default)]
    pub density_step: f32,
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
