//! The table's kernels of a training step, in the order in which they run.

use crate::kernel::{Access, Binding, Kernel, kernel_of};
use crate::kernels::{bind, bind_array};
use crate::layout::{
    BrickPlace, GradientPoint, LayerParams, Level, Moments, PartParams, Ray, RayLoss, RaySample,
    RaySummary, RayTarget, SkyGrid, SlotSample, StepState, TrainParams, View,
};
use crate::{BLOCK_FLOATS, LAYER_1_BLOCKS, LAYER_2_BLOCKS, LAYER_3_BLOCKS};

/// A 4x4 block of weights.
type Block = [f32; BLOCK_FLOATS];
type Quad = [f32; 4];

/// Moves rays as the poses of their views are corrected; one thread a ray.
pub const CORRECT_RAYS: Kernel = Kernel {
    bindings: &[
        bind::<TrainParams>("params", Access::Uniform),
        bind::<RayTarget>("targets", Access::Read),
        bind::<View>("views", Access::Read),
        bind::<Ray>("rays", Access::ReadWrite),
        bind::<u32>("view_sums", Access::ReadWrite),
    ],
    workgroup_size: 64,
    ..kernel_of!(
        "correct_rays",
        "types",
        "training",
        "angles",
        "rotation",
        "correct_rays"
    )
};

/// Weights the marched samples and lists those that are coloured; one thread a ray.
pub const COMPOSITE_SAMPLES: Kernel = Kernel {
    bindings: &[
        bind::<TrainParams>("params", Access::Uniform),
        bind::<RaySummary>("summaries", Access::Read),
        bind::<RaySample>("samples", Access::Read),
        bind::<RayTarget>("targets", Access::Read),
        bind::<f32>("weights", Access::ReadWrite),
        bind::<u32>("slots", Access::ReadWrite),
        bind::<SlotSample>("slot_samples", Access::ReadWrite),
        bind::<u32>("first_points", Access::ReadWrite),
        bind::<u32>("counters", Access::ReadWrite),
    ],
    workgroup_size: 64,
    ..kernel_of!(
        "composite_samples",
        "types",
        "transcendental",
        "training",
        "composite_samples"
    )
};

/// The colour network's inputs of coloured samples, from one part of the nodes; any number of threads.
pub const GATHER_INPUTS: Kernel = Kernel {
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
        bind::<Quad>("slot_inputs", Access::ReadWrite),
    ],
    workgroup_size: 64,
    ..kernel_of!(
        "gather_inputs",
        "types",
        "lattice",
        "features",
        "angles",
        "view_inputs",
        "training",
        "gather_inputs"
    )
};

/// Colours of coloured samples; any number of threads.
pub const NETWORK_FORWARD: Kernel = Kernel {
    bindings: FORWARD_BINDINGS,
    workgroup_size: 64,
    parameters: &["WIDTH_BLOCKS", "KEEPS_HIDDEN"],
    ..kernel_of!(
        "network_forward",
        "types",
        "transcendental",
        "network",
        "training",
        "network_forward"
    )
};

/// [`NETWORK_FORWARD`] with four samples a thread, and weights that the threads of a subgroup read together.
pub const NETWORK_FORWARD_FOUR: Kernel = Kernel {
    bindings: FORWARD_BINDINGS,
    workgroup_size: crate::FOUR_SAMPLE_THREADS,
    uses_subgroup: true,
    parameters: &["WIDTH_BLOCKS", "KEEPS_HIDDEN"],
    ..kernel_of!(
        "network_forward_four",
        "types",
        "transcendental",
        "network_four",
        "training",
        "network_forward_four"
    )
};

const FORWARD_BINDINGS: &[Binding] = &[
    bind_array::<Block>("layer_1", LAYER_1_BLOCKS),
    bind_array::<Block>("layer_2", LAYER_2_BLOCKS),
    bind_array::<Block>("layer_3", LAYER_3_BLOCKS),
    bind::<u32>("counters", Access::Read),
    bind::<Quad>("slot_inputs", Access::Read),
    bind::<Quad>("hidden_a", Access::ReadWrite),
    bind::<Quad>("hidden_b", Access::ReadWrite),
    bind::<Quad>("slot_colors", Access::ReadWrite),
];

/// Losses of every ray and their gradients by colours, densities, sky and exposures; one thread a ray.
pub const RAY_LOSSES: Kernel = Kernel {
    bindings: &[
        bind::<TrainParams>("params", Access::Uniform),
        bind::<Ray>("rays", Access::Read),
        bind::<RayTarget>("targets", Access::Read),
        bind::<RaySummary>("summaries", Access::Read),
        bind::<RaySample>("samples", Access::Read),
        bind::<f32>("weights", Access::Read),
        bind::<u32>("slots", Access::Read),
        bind::<u32>("first_points", Access::Read),
        bind::<Quad>("slot_colors", Access::Read),
        bind::<SkyGrid>("sky_grids", Access::Read),
        bind::<f32>("sky_logits", Access::Read),
        bind::<View>("views", Access::Read),
        bind::<Quad>("slot_color_gradients", Access::ReadWrite),
        bind::<GradientPoint>("points", Access::ReadWrite),
        bind::<u32>("sky_gradients", Access::ReadWrite),
        bind::<RayLoss>("ray_losses_out", Access::ReadWrite),
        bind::<u32>("view_sums", Access::ReadWrite),
        bind::<StepState>("state", Access::Read),
    ],
    workgroup_size: 64,
    ..kernel_of!(
        "ray_losses",
        "types",
        "transcendental",
        "training",
        "losses",
        "angles",
        "sky",
        "view_sums",
        "ray_losses"
    )
};

/// Gradients by the colour network's neurons and features; any number of threads.
pub const NETWORK_BACKWARD: Kernel = Kernel {
    bindings: BACKWARD_BINDINGS,
    workgroup_size: 64,
    parameters: &["WIDTH_BLOCKS"],
    ..kernel_of!(
        "network_backward",
        "types",
        "transcendental",
        "network",
        "training",
        "network_backward"
    )
};

/// [`NETWORK_BACKWARD`] in the manner of [`NETWORK_FORWARD_FOUR`].
pub const NETWORK_BACKWARD_FOUR: Kernel = Kernel {
    bindings: BACKWARD_BINDINGS,
    workgroup_size: crate::FOUR_SAMPLE_THREADS,
    uses_subgroup: true,
    parameters: &["WIDTH_BLOCKS"],
    ..kernel_of!(
        "network_backward_four",
        "types",
        "transcendental",
        "network_four",
        "training",
        "network_backward_four"
    )
};

const BACKWARD_BINDINGS: &[Binding] = &[
    bind_array::<Block>("layer_1", LAYER_1_BLOCKS),
    bind_array::<Block>("layer_2", LAYER_2_BLOCKS),
    bind_array::<Block>("layer_3", LAYER_3_BLOCKS),
    bind::<u32>("counters", Access::Read),
    bind::<Quad>("hidden_a", Access::Read),
    bind::<Quad>("hidden_b", Access::Read),
    bind::<Quad>("slot_colors", Access::Read),
    bind::<Quad>("slot_color_gradients", Access::ReadWrite),
    bind::<Quad>("gradients_a", Access::ReadWrite),
    bind::<Quad>("gradients_b", Access::ReadWrite),
    bind::<Quad>("slot_gradients", Access::ReadWrite),
];

/// Gradient of one layer's weights; one thread a tile of 16 x 16 weights and a share of the samples.
pub const LAYER_GRADIENTS: Kernel = Kernel {
    bindings: &[
        bind::<LayerParams>("layer", Access::Uniform),
        bind::<u32>("counters", Access::Read),
        bind::<Quad>("layer_inputs", Access::Read),
        bind::<Quad>("output_gradients", Access::Read),
        bind::<Block>("weight_gradients", Access::ReadWrite),
    ],
    workgroup_size: 8,
    ..kernel_of!("layer_gradients", "types", "training", "layer_gradients")
};

/// [`LAYER_GRADIENTS`] whose threads read together; one workgroup eight quads of the side that is not divided among the threads, and a
/// share of the samples.
pub const LAYER_GRADIENTS_SHARED: Kernel = Kernel {
    bindings: LAYER_GRADIENTS.bindings,
    workgroup_size: crate::SUBGROUP,
    uses_subgroup: true,
    parameters: &["TAKES_INPUTS"],
    ..kernel_of!(
        "layer_gradients_shared",
        "types",
        "training",
        "layer_gradients_shared"
    )
};

/// Adds the gradients of points to the nodes around them that one part holds; any number of threads.
pub const SCATTER_GRADIENTS: Kernel = Kernel {
    bindings: &[
        bind::<PartParams>("part", Access::Uniform),
        bind::<Level>("levels", Access::Read),
        bind::<u32>("brick_index", Access::Read),
        bind::<u32>("counters", Access::Read),
        bind::<GradientPoint>("points", Access::Read),
        bind::<Quad>("slot_gradients", Access::Read),
        bind::<u32>("density_gradients", Access::ReadWrite),
        bind::<u32>("gradients_a", Access::ReadWrite),
        bind::<u32>("gradients_b", Access::ReadWrite),
        bind::<u32>("gradients_c", Access::ReadWrite),
        bind::<u32>("brick_marks", Access::ReadWrite),
        bind::<u32>("touched_bricks", Access::ReadWrite),
    ],
    workgroup_size: 64,
    ..kernel_of!(
        "scatter_gradients",
        "types",
        "lattice",
        "training",
        "add_gradients",
        "scatter_gradients"
    )
};

/// Gradients by the poses of views through the nodes that one part holds; one thread a ray.
pub const POSE_GRADIENTS: Kernel = Kernel {
    bindings: &[
        bind::<TrainParams>("params", Access::Uniform),
        bind::<PartParams>("part", Access::Uniform),
        bind::<Level>("levels", Access::Read),
        bind::<u32>("brick_index", Access::Read),
        bind::<f32>("density", Access::Read),
        bind::<Quad>("features_a", Access::Read),
        bind::<Quad>("features_b", Access::Read),
        bind::<Quad>("features_c", Access::Read),
        bind::<RayTarget>("targets", Access::Read),
        bind::<RaySummary>("summaries", Access::Read),
        bind::<u32>("first_points", Access::Read),
        bind::<GradientPoint>("points", Access::Read),
        bind::<Quad>("slot_gradients", Access::Read),
        bind::<View>("views", Access::Read),
        bind::<u32>("view_sums", Access::ReadWrite),
    ],
    workgroup_size: 64,
    ..kernel_of!(
        "pose_gradients",
        "types",
        "lattice",
        "training",
        "angles",
        "rotation",
        "view_sums",
        "pose_gradients"
    )
};

/// Sums of a step's rays; one workgroup.
pub const SUM_STEP: Kernel = Kernel {
    bindings: &[
        bind::<TrainParams>("params", Access::Uniform),
        bind::<RayLoss>("ray_losses", Access::Read),
        bind::<u32>("counters", Access::Read),
        bind::<StepState>("state", Access::ReadWrite),
    ],
    workgroup_size: 256,
    ..kernel_of!("sum_step", "types", "training", "sum_step")
};

/// Moves the nodes of one part's touched bricks against their gradients; any number of workgroups.
pub const STEP_BRICKS: Kernel = Kernel {
    bindings: &[
        bind::<TrainParams>("params", Access::Uniform),
        bind::<PartParams>("part", Access::Uniform),
        bind::<StepState>("state", Access::Read),
        bind::<u32>("touched_bricks", Access::Read),
        bind::<f32>("density", Access::ReadWrite),
        bind::<Quad>("features_a", Access::ReadWrite),
        bind::<Quad>("features_b", Access::ReadWrite),
        bind::<Quad>("features_c", Access::ReadWrite),
        bind::<f32>("density_gradients", Access::ReadWrite),
        bind::<Quad>("gradients_a", Access::ReadWrite),
        bind::<Quad>("gradients_b", Access::ReadWrite),
        bind::<Quad>("gradients_c", Access::ReadWrite),
        bind::<f32>("density_squares", Access::ReadWrite),
        bind::<f32>("feature_squares", Access::ReadWrite),
        bind::<u32>("brick_marks", Access::ReadWrite),
    ],
    workgroup_size: 64,
    parameters: &["DECAY", "EPSILON"],
    ..kernel_of!("step_bricks", "types", "training", "step_bricks")
};

/// Adam's step of the colour network; one thread a weight.
pub const STEP_NETWORK: Kernel = Kernel {
    bindings: &[
        bind::<TrainParams>("params", Access::Uniform),
        bind::<StepState>("state", Access::Read),
        bind::<f32>("weight_gradients", Access::ReadWrite),
        bind::<Moments>("moments", Access::ReadWrite),
        bind::<f32>("network", Access::ReadWrite),
    ],
    workgroup_size: 64,
    parameters: &["BETA_1", "BETA_2", "EPSILON"],
    ..kernel_of!("step_network", "types", "training", "adam", "step_network")
};

/// Moves the sky's texels against their gradients; any number of threads.
pub const STEP_SKY: Kernel = Kernel {
    bindings: &[
        bind::<TrainParams>("params", Access::Uniform),
        bind::<StepState>("state", Access::Read),
        bind::<f32>("sky_gradients", Access::ReadWrite),
        bind::<f32>("sky_squares", Access::ReadWrite),
        bind::<f32>("sky_logits", Access::ReadWrite),
    ],
    workgroup_size: 64,
    parameters: &["DECAY"],
    ..kernel_of!("step_sky", "types", "training", "step_sky")
};

/// Moves the corrections of views against their gradients; one workgroup.
pub const STEP_VIEWS: Kernel = Kernel {
    bindings: &[
        bind::<TrainParams>("params", Access::Uniform),
        bind::<StepState>("state", Access::Read),
        bind::<View>("views", Access::ReadWrite),
        bind::<u32>("view_sums", Access::ReadWrite),
        bind::<Moments>("moments", Access::ReadWrite),
    ],
    workgroup_size: 64,
    parameters: &["BETA_1", "BETA_2", "EPSILON", "ARM_M"],
    ..kernel_of!(
        "step_views",
        "types",
        "training",
        "angles",
        "rotation",
        "adam",
        "step_views"
    )
};

/// Gradients of the total variation between one part's touched bricks and what a part holds; any number of workgroups.
pub const BRICK_VARIATION: Kernel = Kernel {
    bindings: &[
        bind::<TrainParams>("params", Access::Uniform),
        bind::<PartParams>("part", Access::Uniform),
        bind::<PartParams>("other_part", Access::Uniform),
        bind::<Level>("levels", Access::Read),
        bind::<u32>("brick_index", Access::Read),
        bind::<BrickPlace>("brick_places", Access::Read),
        bind::<u32>("touched_bricks", Access::Read),
        bind::<f32>("density", Access::Read),
        bind::<Quad>("features_a", Access::Read),
        bind::<Quad>("features_b", Access::Read),
        bind::<Quad>("features_c", Access::Read),
        bind::<f32>("other_density", Access::Read),
        bind::<Quad>("other_features_a", Access::Read),
        bind::<Quad>("other_features_b", Access::Read),
        bind::<Quad>("other_features_c", Access::Read),
        bind::<f32>("density_gradients", Access::ReadWrite),
        bind::<Quad>("gradients_a", Access::ReadWrite),
        bind::<Quad>("gradients_b", Access::ReadWrite),
        bind::<Quad>("gradients_c", Access::ReadWrite),
    ],
    workgroup_size: 64,
    ..kernel_of!(
        "brick_variation",
        "types",
        "lattice",
        "training",
        "brick_variation"
    )
};

/// Moves the nodes of one part's touched bricks against those; any number of workgroups.
pub const SMOOTH_BRICKS: Kernel = Kernel {
    bindings: &[
        bind::<TrainParams>("params", Access::Uniform),
        bind::<PartParams>("part", Access::Uniform),
        bind::<StepState>("state", Access::Read),
        bind::<u32>("touched_bricks", Access::Read),
        bind::<f32>("density", Access::ReadWrite),
        bind::<Quad>("features_a", Access::ReadWrite),
        bind::<Quad>("features_b", Access::ReadWrite),
        bind::<Quad>("features_c", Access::ReadWrite),
        bind::<f32>("density_gradients", Access::ReadWrite),
        bind::<Quad>("gradients_a", Access::ReadWrite),
        bind::<Quad>("gradients_b", Access::ReadWrite),
        bind::<Quad>("gradients_c", Access::ReadWrite),
    ],
    workgroup_size: 64,
    ..kernel_of!("smooth_bricks", "types", "training", "smooth_bricks")
};
