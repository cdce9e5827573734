//! The table's kernels of merged rendering, in the order in which they run.

use crate::kernel::{Access, Binding, Kernel, kernel_of};
use crate::kernels::{bind, bind_array};
use crate::layout::{
    Block, Level, MarchParams, PartParams, Ray, RaySample, RaySummary, SkyGrid, SlotSample,
};
use crate::scene_layout::{
    EyeParams, ObjectBox, RayHit, RayPairs, RayRequest, SampleList, SceneParams, SlotRange,
    Weighted,
};
use crate::{BLOCK_FLOATS, LAYER_1_BLOCKS, LAYER_2_BLOCKS, LAYER_3_BLOCKS};

type Quad = [f32; 4];
/// A 4x4 block of weights.
type WeightBlock = [f32; BLOCK_FLOATS];

/// Rays of a camera in a field's frame; one thread a ray.
pub const EYE_RAYS: Kernel = Kernel {
    bindings: &[
        bind::<EyeParams>("params", Access::Uniform),
        bind::<RayRequest>("requests", Access::Read),
        bind::<Ray>("rays", Access::ReadWrite),
        bind::<RayHit>("hits", Access::ReadWrite),
    ],
    workgroup_size: 64,
    ..kernel_of!("eye_rays", "types", "scene", "eye_rays")
};

/// Drops what an object's field holds below its wheels; one thread a pair of ray and object.
pub const OBJECT_SAMPLES: Kernel = Kernel {
    bindings: &[
        bind::<SceneParams>("scene", Access::Uniform),
        bind::<Ray>("rays", Access::Read),
        bind::<RaySummary>("summaries", Access::Read),
        bind::<RaySample>("samples", Access::ReadWrite),
        bind::<SampleList>("lists", Access::ReadWrite),
        bind::<Weighted>("weighted", Access::ReadWrite),
        bind::<u32>("worst", Access::ReadWrite),
    ],
    workgroup_size: 64,
    ..kernel_of!(
        "object_samples",
        "types",
        "transcendental",
        "scene",
        "object_samples"
    )
};

/// Marches the background and merges it with the objects' samples; one thread a ray.
pub const MERGE_SCENE: Kernel = Kernel {
    bindings: MERGE_BINDINGS.split_at(WHOLE_MERGE).0,
    workgroup_size: 64,
    ..kernel_of!(
        "merge_scene",
        "types",
        "transcendental",
        "lattice",
        "whole_density",
        "raw_density",
        "occupancy",
        "density",
        "march",
        "scene",
        "light",
        "merge_scene"
    )
};

/// [`MERGE_SCENE`] of a background whose densities no binding holds.
pub const MERGE_SCENE_SPLIT: Kernel = Kernel {
    name: "merge_scene_split",
    bindings: MERGE_BINDINGS,
    workgroup_size: 64,
    parameters: &["NODES_PER_PART"],
    ..kernel_of!(
        "merge_scene",
        "types",
        "transcendental",
        "lattice",
        "merge_scene_parts",
        "split_density",
        "raw_density",
        "occupancy",
        "density",
        "march",
        "scene",
        "light",
        "merge_scene"
    )
};

const MERGE_BINDINGS: &[Binding] = &[
    bind::<MarchParams>("params", Access::Uniform),
    bind::<SceneParams>("scene", Access::Uniform),
    bind::<Level>("levels", Access::Read),
    bind::<u32>("brick_index", Access::Read),
    bind::<f32>("density", Access::Read),
    bind::<u32>("block_index", Access::Read),
    bind::<Block>("blocks", Access::Read),
    bind::<Ray>("rays", Access::Read),
    bind::<RayPairs>("ray_pairs", Access::Read),
    bind::<u32>("pair_order", Access::Read),
    bind::<Ray>("pair_rays", Access::Read),
    bind::<ObjectBox>("object_boxes", Access::Read),
    bind::<RaySample>("pair_samples", Access::Read),
    bind::<SampleList>("pair_lists", Access::ReadWrite),
    bind::<Weighted>("pair_weighted", Access::ReadWrite),
    bind::<SampleList>("ray_lists", Access::ReadWrite),
    bind::<Weighted>("ray_weighted", Access::ReadWrite),
    bind::<RayHit>("hits", Access::ReadWrite),
    bind::<u32>("worst", Access::ReadWrite),
    bind::<f32>("density_1", Access::Read),
    bind::<f32>("density_2", Access::Read),
    bind::<f32>("density_3", Access::Read),
];
/// Bindings of the kernel whose densities are whole.
const WHOLE_MERGE: usize = MERGE_BINDINGS.len() - (crate::DENSITY_PARTS - 1);

/// Marches rays through densities that no binding holds; one thread a ray.
pub const MARCH_DENSITY_SPLIT: Kernel = Kernel {
    name: "march_density_split",
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
        bind::<f32>("density_1", Access::Read),
        bind::<f32>("density_2", Access::Read),
        bind::<f32>("density_3", Access::Read),
    ],
    workgroup_size: 64,
    parameters: &["NODES_PER_PART"],
    ..kernel_of!(
        "march_density",
        "types",
        "transcendental",
        "lattice",
        "march_density_parts",
        "split_density",
        "raw_density",
        "occupancy",
        "density",
        "march",
        "march_density"
    )
};

/// Interpolates the features of listed samples from one part of the nodes; any number of threads.
pub const SCENE_FEATURES: Kernel = Kernel {
    bindings: &[
        bind::<PartParams>("part", Access::Uniform),
        bind::<Level>("levels", Access::Read),
        bind::<u32>("brick_index", Access::Read),
        bind::<Quad>("features_a", Access::Read),
        bind::<Quad>("features_b", Access::Read),
        bind::<Quad>("features_c", Access::Read),
        bind::<Ray>("rays", Access::Read),
        bind::<SlotSample>("slot_samples", Access::Read),
        bind::<u32>("counters", Access::Read),
        bind::<Quad>("slot_features", Access::ReadWrite),
    ],
    workgroup_size: 64,
    ..kernel_of!(
        "scene_features",
        "types",
        "lattice",
        "features",
        "training",
        "scene",
        "scene_features"
    )
};

/// Colours of listed samples; any number of threads.
pub const SCENE_NETWORK: Kernel = Kernel {
    bindings: &[
        bind_array::<WeightBlock>("layer_1", LAYER_1_BLOCKS),
        bind_array::<WeightBlock>("layer_2", LAYER_2_BLOCKS),
        bind_array::<WeightBlock>("layer_3", LAYER_3_BLOCKS),
        bind::<Ray>("rays", Access::Read),
        bind::<SlotSample>("slot_samples", Access::Read),
        bind::<Quad>("slot_features", Access::Read),
        bind::<u32>("counters", Access::Read),
        bind::<Quad>("slot_colors", Access::ReadWrite),
    ],
    workgroup_size: 64,
    parameters: &["WIDTH_BLOCKS"],
    ..kernel_of!(
        "scene_network",
        "types",
        "transcendental",
        "network",
        "angles",
        "view_inputs",
        "training",
        "scene_network"
    )
};

/// Gives the samples that weigh enough slots in the colour batch; one thread a list.
pub const SCENE_SLOTS: Kernel = Kernel {
    bindings: &[
        bind::<SceneParams>("scene", Access::Uniform),
        bind::<SampleList>("lists", Access::Read),
        bind::<Weighted>("weighted", Access::Read),
        bind::<SlotSample>("slot_samples", Access::ReadWrite),
        bind::<f32>("slot_weights", Access::ReadWrite),
        bind::<SlotRange>("slot_ranges", Access::ReadWrite),
        bind::<u32>("counters", Access::ReadWrite),
        bind::<u32>("worst", Access::ReadWrite),
    ],
    workgroup_size: 64,
    ..kernel_of!("scene_slots", "types", "training", "scene", "scene_slots")
};

/// Sums the coloured samples of every list; one thread a list.
pub const SCENE_COLORS: Kernel = Kernel {
    bindings: &[
        bind::<SceneParams>("scene", Access::Uniform),
        bind::<SlotRange>("slot_ranges", Access::Read),
        bind::<f32>("slot_weights", Access::Read),
        bind::<Quad>("slot_colors", Access::Read),
        bind::<Quad>("colors", Access::ReadWrite),
    ],
    workgroup_size: 64,
    ..kernel_of!("scene_colors", "types", "scene", "scene_colors")
};

/// Fills the light that rays have left with the sky; one thread a ray.
pub const SCENE_SKY: Kernel = Kernel {
    bindings: &[
        bind::<SceneParams>("params", Access::Uniform),
        bind::<Ray>("rays", Access::Read),
        bind::<RayHit>("hits", Access::Read),
        bind::<SkyGrid>("sky_grids", Access::Read),
        bind::<f32>("sky_logits", Access::Read),
        bind::<Quad>("colors", Access::ReadWrite),
    ],
    workgroup_size: 64,
    ..kernel_of!(
        "scene_sky",
        "types",
        "transcendental",
        "training",
        "scene",
        "angles",
        "sky",
        "scene_sky"
    )
};
