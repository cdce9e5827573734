//! The table of kernels; a test compares it with the files of `wgsl/`.

use crate::kernel::{Access, Binding, Kernel, kernel_of};
use crate::layout::{Block, Level, MarchParams, Ray, RaySample, RaySummary};

pub use crate::grid::{
    GRID_COLORS, GRID_INPUTS, GRID_LOSSES, MARCH_GRID, SCATTER_GRID, STEP_GRID, WAKE_BRICKS,
};
pub use crate::scene::{
    EYE_RAYS, MARCH_DENSITY_SPLIT, MERGE_SCENE, MERGE_SCENE_SPLIT, OBJECT_SAMPLES, SCENE_COLORS,
    SCENE_FEATURES, SCENE_NETWORK, SCENE_SKY, SCENE_SLOTS,
};
pub use crate::training::{
    BRICK_VARIATION, COMPOSITE_SAMPLES, CORRECT_RAYS, GATHER_INPUTS, LAYER_GRADIENTS,
    LAYER_GRADIENTS_SHARED, NETWORK_BACKWARD, NETWORK_BACKWARD_FOUR, NETWORK_FORWARD,
    NETWORK_FORWARD_FOUR, POSE_GRADIENTS, RAY_LOSSES, SCATTER_GRADIENTS, SMOOTH_BRICKS,
    STEP_BRICKS, STEP_NETWORK, STEP_SKY, STEP_VIEWS, SUM_STEP,
};

/// Marches rays through a density pyramid; one thread a ray.
pub const MARCH_DENSITY: Kernel = Kernel {
    bindings: &[
        bind::<MarchParams>("params", Access::Uniform),
        bind::<Level>("levels", Access::Read),
        bind::<u32>("brick_index", Access::Read),
        bind::<f32>("density", Access::Read),
        bind::<u32>("block_index", Access::Read),
        bind::<Block>("blocks", Access::Read),
        bind::<Ray>("rays", Access::Read),
        bind::<RaySummary>("summaries", Access::ReadWrite),
        bind::<RaySample>("samples", Access::ReadWrite),
    ],
    workgroup_size: 64,
    ..kernel_of!(
        "march_density",
        "types",
        "transcendental",
        "lattice",
        "whole_density",
        "raw_density",
        "occupancy",
        "density",
        "march",
        "march_density"
    )
};

/// Every kernel.
pub const ALL: &[Kernel] = &[
    CORRECT_RAYS,
    MARCH_DENSITY,
    COMPOSITE_SAMPLES,
    GATHER_INPUTS,
    NETWORK_FORWARD,
    NETWORK_FORWARD_FOUR,
    RAY_LOSSES,
    NETWORK_BACKWARD,
    NETWORK_BACKWARD_FOUR,
    LAYER_GRADIENTS,
    LAYER_GRADIENTS_SHARED,
    SCATTER_GRADIENTS,
    POSE_GRADIENTS,
    SUM_STEP,
    STEP_BRICKS,
    STEP_NETWORK,
    STEP_SKY,
    STEP_VIEWS,
    BRICK_VARIATION,
    SMOOTH_BRICKS,
    EYE_RAYS,
    OBJECT_SAMPLES,
    MERGE_SCENE,
    SCENE_SLOTS,
    MARCH_DENSITY_SPLIT,
    MERGE_SCENE_SPLIT,
    SCENE_FEATURES,
    SCENE_NETWORK,
    SCENE_COLORS,
    SCENE_SKY,
    MARCH_GRID,
    GRID_INPUTS,
    GRID_COLORS,
    GRID_LOSSES,
    SCATTER_GRID,
    WAKE_BRICKS,
    STEP_GRID,
];

pub(crate) const fn bind<T>(name: &'static str, access: Access) -> Binding {
    Binding {
        name,
        access,
        min_bytes: size_of::<T>() as u64,
    }
}

/// A uniform array of `len` values of `T`.
pub(crate) const fn bind_array<T>(name: &'static str, len: usize) -> Binding {
    Binding {
        name,
        access: Access::Uniform,
        min_bytes: (len * size_of::<T>()) as u64,
    }
}
