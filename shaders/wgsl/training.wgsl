// Records of a training step that its kernels share.

// A sample without colour.
const NO_SLOT: u32 = 0xffffffffu;

// Where `counters` counts what a batch of rays has.
const COLORED_COUNT: u32 = 0u;
const POINT_COUNT: u32 = 1u;
// The same over all batches of the step.
const STEP_COLORED_COUNT: u32 = 2u;
const STEP_POINT_COUNT: u32 = 3u;

// RayTarget.backdrop_kind: what fills the transmittance that a ray has left.
const BACKDROP_SKY: u32 = 0u;
const BACKDROP_SKY_AS_IS: u32 = 1u;

// RayTarget.silhouette.
const SILHOUETTE_UNKNOWN: u32 = 0u;
const SILHOUETTE_OPAQUE: u32 = 1u;

struct TrainParams {
    // Length in metres that raw densities are activated for.
    base_voxel_m: f32,
    level_count: u32,
    sky_grid_count: u32,
    // Rays of the batch, and the batch's first within the step.
    ray_count: u32,
    first_ray: u32,
    // Rays of the whole step.
    step_ray_count: u32,
    // Samples stored for each ray.
    sample_capacity: u32,
    step: u32,
    // Samples of lighter weight take no part in colour.
    min_weight: f32,
    sample_color: f32,
    entropy: f32,
    depth_scale_m: f32,
    depth_cap_m: f32,
    depth_trim_m: f32,
    // 1: the composited range's absolute error; 0: the expected robust error.
    depth_is_composited: u32,
    // 1: the rectified loss as printed; 0: cross-entropy.
    rectified_is_printed: u32,
    distortion: f32,
    distortion_scale_m: f32,
    density_rate: f32,
    feature_rate: f32,
    network_rate: f32,
    sky_rate: f32,
    density_variation_rate: f32,
    feature_variation_rate: f32,
    // Views with corrections, of exposure and pose; 0 while none are learned.
    view_count: u32,
    // Adam's, its bias corrections included; 0 leaves exposures or poses as they are.
    exposure_rate: f32,
    pose_rate: f32,
    // How strongly both are drawn to the recorded ones.
    exposure_prior: f32,
    pose_prior: f32,
    // The part of the list of touched bricks that is moved.
    first_touched: u32,
    touched_end: u32,
    // Quantile of the range errors that the next step takes for outliers; 0 keeps depth_trim_m.
    trim_quantile: f32,
    sky_texel_count: u32,
}

// What a ray should have shown. Weights hold the loss's weight and the batch mean's divisor; 0 switches a target off.
struct RayTarget {
    color: vec3<f32>,
    color_weight: f32,
    backdrop: vec3<f32>,
    silhouette_weight: f32,
    range_m: f32,
    range_weight: f32,
    backdrop_kind: u32,
    silhouette: u32,
    view: u32,
    // 1: reflected about the x-z plane.
    mirrored: u32,
}

// A coloured sample.
struct SlotSample {
    ray: u32,
    // Distance along the ray, metres.
    t: f32,
}

// A sample's place and gradient.
struct GradientPoint {
    position_m: vec3<f32>,
    // By the raw density there.
    raw: f32,
    // Row of the feature gradients, or NO_SLOT.
    slot: u32,
}

// One latitude-longitude grid of the sky.
struct SkyGrid {
    width: u32,
    height: u32,
    // Its first texel.
    start: u32,
}

// What a ray adds to the step's sums.
struct RayLoss {
    // Mean squared error; 0 without colour.
    squared_error: f32,
    // Weighted sum of the ray's losses.
    loss: f32,
    // Absolute error of the composited range, metres; below 0 for none.
    range_error_m: f32,
    // 1 for a colour ray.
    is_color: u32,
}

// Sums of the step that was summed last.
struct StepState {
    squared_error: f32,
    loss: f32,
    color_rays: u32,
    samples: u32,
    colored: u32,
    // Range errors above this are outliers for the next step, metres.
    depth_trim_m: f32,
    // Steps whose sums were finite. The first one with others ends learning: nothing moves from then on.
    finite_steps: u32,
    // 1 once sums were not finite.
    diverged: u32,
}

// What is corrected about a view; fourth components mean nothing but in the rotation. Exposure: color' = exp(log_gain) color + bias.
// Pose, in the field's frame: p' = rotation p + translation_m, the rotation as a quaternion whose real part comes last.
struct View {
    log_gain: vec4<f32>,
    bias: vec4<f32>,
    rotation: vec4<f32>,
    translation_m: vec4<f32>,
}

// What each view sums: gradients by log gain, bias, a small rotation after the present one (rad) and the translation, then whether it has
// had a ray.
const VIEW_SUMS: u32 = 13u;
const BY_LOG_GAIN: u32 = 0u;
const BY_BIAS: u32 = 3u;
const BY_ROTATION: u32 = 6u;
const BY_TRANSLATION: u32 = 9u;
const IS_SEEN: u32 = 12u;

// One layer of the colour network, for the gradient of its weights.
struct LayerParams {
    // Quads of inputs and of outputs of a sample.
    input_quads: u32,
    output_quads: u32,
    // Shares that the samples are divided into, each with weight gradients of its own.
    shares: u32,
    // Blocks of all weights, and where the layer's begin.
    weight_blocks: u32,
    first_block: u32,
    // Where the biases' blocks begin; 0 for a layer whose bias is the weight of an input.
    first_bias: u32,
}

// Where a stored brick lies.
struct BrickPlace {
    // Brick position within its level.
    position: vec3<u32>,
    level: u32,
}
