//! The table of kernels; a test compares it with the files of `wgsl/`.

use crate::kernel::{Access, Binding, Kernel};
use crate::layout::{Block, Level, MarchParams, Ray, RaySample, RaySummary};

/// Marches rays through a density pyramid; one thread a ray.
pub const MARCH_DENSITY: Kernel = Kernel {
    name: "march_density",
    files: &[
        "types.wgsl",
        "lattice.wgsl",
        "occupancy.wgsl",
        "density.wgsl",
        "march_density.wgsl",
    ],
    source: concat!(
        include_str!("../wgsl/types.wgsl"),
        include_str!("../wgsl/lattice.wgsl"),
        include_str!("../wgsl/occupancy.wgsl"),
        include_str!("../wgsl/density.wgsl"),
        include_str!("../wgsl/march_density.wgsl"),
    ),
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
};

/// Every kernel.
pub const ALL: &[Kernel] = &[MARCH_DENSITY];

const fn bind<T>(name: &'static str, access: Access) -> Binding {
    Binding {
        name,
        access,
        min_bytes: size_of::<T>() as u64,
    }
}
