//! The table's kernels of training on dense grids, in the order in which they run; those of the colour network are
//! [`crate::kernels`]' own.

use crate::grid_layout::{
    GridParams, GridPoint, GridSample, GridSlot, MaskBlock, PixelRay, RayLight,
};
use crate::kernel::{Access, Kernel, kernel_of};
use crate::kernels::bind;
use crate::layout::{RayLoss, StepState};

type Quad = [f32; 4];

/// Samples of rays at a fixed pitch, their weights, and which are coloured; one thread a ray.
pub const MARCH_GRID: Kernel = Kernel {
    bindings: &[
        bind::<GridParams>("params", Access::Uniform),
        bind::<MaskBlock>("mask", Access::Read),
        bind::<f32>("density", Access::Read),
        bind::<PixelRay>("rays", Access::Read),
        bind::<GridSample>("samples", Access::ReadWrite),
        bind::<RayLight>("lights", Access::ReadWrite),
        bind::<GridSlot>("slots", Access::ReadWrite),
        bind::<u32>("counters", Access::ReadWrite),
    ],
    workgroup_size: 64,
    ..kernel_of!(
        "march_grid",
        "types",
        "transcendental",
        "training",
        "grid",
        "march_grid"
    )
};

/// The colour network's inputs of coloured samples; any number of threads.
pub const GRID_INPUTS: Kernel = Kernel {
    bindings: &[
        bind::<GridParams>("params", Access::Uniform),
        bind::<Quad>("features_a", Access::Read),
        bind::<Quad>("features_b", Access::Read),
        bind::<Quad>("features_c", Access::Read),
        bind::<PixelRay>("rays", Access::Read),
        bind::<GridSample>("samples", Access::Read),
        bind::<GridSlot>("slots", Access::Read),
        bind::<u32>("counters", Access::Read),
        bind::<Quad>("slot_inputs", Access::ReadWrite),
    ],
    workgroup_size: 64,
    ..kernel_of!(
        "grid_inputs",
        "types",
        "angles",
        "view_inputs",
        "training",
        "grid",
        "grid_inputs"
    )
};

/// Colours of coloured samples where the grid stores them itself; any number of threads.
pub const GRID_COLORS: Kernel = Kernel {
    bindings: &[
        bind::<GridParams>("params", Access::Uniform),
        bind::<Quad>("colors", Access::Read),
        bind::<GridSample>("samples", Access::Read),
        bind::<GridSlot>("slots", Access::Read),
        bind::<u32>("counters", Access::Read),
        bind::<Quad>("slot_colors", Access::ReadWrite),
    ],
    workgroup_size: 64,
    ..kernel_of!(
        "grid_colors",
        "types",
        "transcendental",
        "training",
        "grid",
        "grid_colors"
    )
};

/// Losses of every ray and their gradients by colours and raw densities; one thread a ray.
pub const GRID_LOSSES: Kernel = Kernel {
    bindings: &[
        bind::<GridParams>("params", Access::Uniform),
        bind::<PixelRay>("rays", Access::Read),
        bind::<RayLight>("lights", Access::Read),
        bind::<GridSample>("samples", Access::Read),
        bind::<Quad>("slot_colors", Access::Read),
        bind::<Quad>("slot_color_gradients", Access::ReadWrite),
        bind::<GridPoint>("points", Access::ReadWrite),
        bind::<RayLoss>("ray_losses_out", Access::ReadWrite),
    ],
    workgroup_size: 64,
    parameters: &["IS_DIRECT"],
    ..kernel_of!(
        "grid_losses",
        "types",
        "transcendental",
        "training",
        "losses",
        "grid",
        "grid_losses"
    )
};

/// Adds the gradients of points to the nodes around them; any number of threads.
pub const SCATTER_GRID: Kernel = Kernel {
    bindings: &[
        bind::<GridParams>("params", Access::Uniform),
        bind::<u32>("counters", Access::Read),
        bind::<GridPoint>("points", Access::Read),
        bind::<Quad>("slot_gradients", Access::Read),
        bind::<u32>("density_gradients", Access::ReadWrite),
        bind::<u32>("gradients_a", Access::ReadWrite),
        bind::<u32>("gradients_b", Access::ReadWrite),
        bind::<u32>("gradients_c", Access::ReadWrite),
        bind::<u32>("brick_seen", Access::ReadWrite),
    ],
    workgroup_size: 64,
    parameters: &["QUADS"],
    ..kernel_of!(
        "scatter_grid",
        "types",
        "training",
        "grid",
        "add_gradients",
        "scatter_grid"
    )
};

/// Decides which bricks move in a step; one thread a brick.
pub const WAKE_BRICKS: Kernel = Kernel {
    bindings: &[
        bind::<GridParams>("params", Access::Uniform),
        bind::<u32>("brick_seen", Access::Read),
        bind::<u32>("brick_moved", Access::ReadWrite),
        bind::<u32>("brick_turns", Access::ReadWrite),
    ],
    workgroup_size: 64,
    parameters: &["LIVELY_STEPS"],
    ..kernel_of!("wake_bricks", "types", "grid", "wake_bricks")
};

/// Adam's step of one kind of values in the bricks that move; any number of workgroups.
pub const STEP_GRID: Kernel = Kernel {
    bindings: &[
        bind::<GridParams>("params", Access::Uniform),
        bind::<StepState>("state", Access::Read),
        bind::<u32>("brick_turns", Access::Read),
        bind::<f32>("shares", Access::Read),
        bind::<f32>("values", Access::ReadWrite),
        bind::<f32>("gradients", Access::ReadWrite),
        bind::<f32>("means", Access::ReadWrite),
        bind::<f32>("squares", Access::ReadWrite),
    ],
    workgroup_size: 64,
    parameters: &["BETA_1", "BETA_2", "EPSILON", "VALUES_PER_NODE"],
    ..kernel_of!(
        "step_grid",
        "types",
        "training",
        "adam",
        "grid",
        "step_grid"
    )
};
