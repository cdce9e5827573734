//! Host mirrors of the structs in `wgsl/`, field by field in the same order; `tests/layout.rs` compares them with naga's offsets.
//!
//! Padding that WGSL leaves at a struct's end is a field here, so that the mirrors are plain bytes.

use bytemuck::{Pod, Zeroable};

/// One lattice level of a density pyramid; node (i, j, k) lies at `origin_m + (i, j, k) * voxel_m` in the local frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Level {
    pub origin_m: [f32; 3],
    pub voxel_m: f32,
    /// Brick positions along x, y and z; the index has one more cell per axis.
    pub bricks: [u32; 3],
    /// Where the level's dense brick index starts in the index buffer.
    pub index_start: u32,
}

/// A range of the nodes: what no binding holds as a whole is taken part by part.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct PartParams {
    pub level_count: u32,
    pub first_node: u32,
    pub node_count: u32,
    /// First node of the binding that holds the part's densities, for kernels that have one.
    pub first_density: u32,
}

/// A stored block of 8^3 occupancy cells.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Block {
    /// Bit `(z * 8 + y) * 8 + x` of the 512 bits says that density may be in cell (x, y, z).
    pub mask: [u32; 16],
    /// Step of a ray inside the block, metres.
    pub step_m: f32,
}

/// A ray in the field's local frame and the part of it to march; `direction` is unit length, distances are metres.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Ray {
    pub origin_m: [f32; 3],
    pub t_min: f32,
    pub direction: [f32; 3],
    pub t_max: f32,
    /// Marching ends once the optical depth exceeds this.
    pub stop_tau: f32,
    /// Where in each interval the density is read, 0..1.
    pub phase: f32,
    pub padding: [u32; 2],
}

/// What marching found on one ray.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct RaySummary {
    /// Optical depth: sum of sigma * dt.
    pub tau: f32,
    /// Sum of the samples' weights.
    pub accumulation: f32,
    /// Sum of weight * t in metres: the expected distance times the accumulation.
    pub weighted_distance_m: f32,
    pub sample_count: u32,
}

/// One interval of a ray with the density at a point in it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct RaySample {
    /// Distance from the ray's origin to the sampled point, metres.
    pub t: f32,
    /// Length of the interval, metres.
    pub dt: f32,
    /// Density, 1/m.
    pub sigma: f32,
}

/// Parameters of `march_density`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct MarchParams {
    /// Lower corner of the box outside of which nothing is.
    pub low_m: [f32; 3],
    /// Length in metres that raw densities are activated for.
    pub base_voxel_m: f32,
    /// Upper corner of the box.
    pub high_m: [f32; 3],
    /// Added to the raw density before the activation.
    pub act_shift: f32,
    pub occupancy_origin_m: [f32; 3],
    /// Edge of an occupancy cell, metres.
    pub cell_m: f32,
    /// Occupancy blocks along x, y and z.
    pub blocks: [u32; 3],
    pub level_count: u32,
    /// Metres of step per metre of distance.
    pub step_growth: f32,
    /// Densities below this (1/m) are dropped.
    pub sigma_min: f32,
    /// Step past a cell's face, metres.
    pub nudge_m: f32,
    pub ray_count: u32,
    /// Samples kept per ray.
    pub sample_capacity: u32,
    /// Workgroups along x of the dispatch.
    pub groups_x: u32,
    /// First ray of the dispatch.
    pub first_ray: u32,
    pub padding: u32,
}

/// Parameters of a training step's kernels for one batch of its rays.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct TrainParams {
    /// Length in metres that raw densities are activated for.
    pub base_voxel_m: f32,
    pub level_count: u32,
    pub sky_grid_count: u32,
    /// Rays of the batch, and the batch's first within the step.
    pub ray_count: u32,
    pub first_ray: u32,
    /// Rays of the whole step.
    pub step_ray_count: u32,
    /// Samples stored for each ray.
    pub sample_capacity: u32,
    pub step: u32,
    /// Samples of lighter weight take no part in colour.
    pub min_weight: f32,
    pub sample_color: f32,
    pub entropy: f32,
    pub depth_scale_m: f32,
    pub depth_cap_m: f32,
    pub depth_trim_m: f32,
    /// 1: the composited range's absolute error; 0: the expected robust error.
    pub depth_is_composited: u32,
    /// 1: the rectified loss as printed; 0: cross-entropy.
    pub rectified_is_printed: u32,
    pub distortion: f32,
    pub distortion_scale_m: f32,
    pub density_rate: f32,
    pub feature_rate: f32,
    /// Of Adam, its bias corrections included.
    pub network_rate: f32,
    pub sky_rate: f32,
    pub density_variation_rate: f32,
    pub feature_variation_rate: f32,
    /// Views with corrections, of exposure and pose; 0 while none are learned.
    pub view_count: u32,
    /// Adam's, its bias corrections included; 0 leaves exposures or poses as they are.
    pub exposure_rate: f32,
    pub pose_rate: f32,
    /// How strongly both are drawn to the recorded ones.
    pub exposure_prior: f32,
    pub pose_prior: f32,
    /// The part of the list of touched bricks that is moved.
    pub first_touched: u32,
    pub touched_end: u32,
    /// Quantile of the range errors that the next step takes for outliers; 0 keeps `depth_trim_m`.
    pub trim_quantile: f32,
    pub sky_texel_count: u32,
}

/// What a ray should have shown; a weight of 0 switches a target off.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct RayTarget {
    /// sRGB.
    pub color: [f32; 3],
    pub color_weight: f32,
    pub backdrop: [f32; 3],
    pub silhouette_weight: f32,
    pub range_m: f32,
    pub range_weight: f32,
    /// 0: the sky, which learns; 1: the sky as it is; 2: `backdrop`.
    pub backdrop_kind: u32,
    /// 0: unknown; 1: opaque; 2: transparent.
    pub silhouette: u32,
    pub view: u32,
    /// 1: reflected about the x-z plane.
    pub mirrored: u32,
    pub padding: [u32; 2],
}

/// A coloured sample.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct SlotSample {
    pub ray: u32,
    /// Distance along the ray, metres.
    pub t: f32,
}

/// A sample's place and gradient.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct GradientPoint {
    pub position_m: [f32; 3],
    /// By the raw density there.
    pub raw: f32,
    /// Row of the feature gradients; `u32::MAX` for none.
    pub slot: u32,
    pub padding: [u32; 3],
}

/// One latitude-longitude grid of the sky.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct SkyGrid {
    pub width: u32,
    pub height: u32,
    /// Its first texel.
    pub start: u32,
}

/// What a ray adds to its step's sums.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct RayLoss {
    /// Mean squared error; 0 without colour.
    pub squared_error: f32,
    /// Weighted sum of the ray's losses.
    pub loss: f32,
    /// Absolute error of the composited range in metres; below 0 for none.
    pub range_error_m: f32,
    /// 1 for a colour ray.
    pub is_color: u32,
}

/// Sums of a step, and what the next one takes over.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct StepState {
    pub squared_error: f32,
    pub loss: f32,
    pub color_rays: u32,
    pub samples: u32,
    pub colored: u32,
    /// Range errors above this are outliers for the next step, metres.
    pub depth_trim_m: f32,
    /// Steps whose sums were finite; the first one with others ends learning.
    pub finite_steps: u32,
    /// 1 once sums were not finite.
    pub diverged: u32,
}

/// What is corrected about a view; fourth components mean nothing but in the rotation. Exposure: `color' = exp(log_gain) color + bias`.
/// Pose, in the field's frame: `p' = rotation p + translation_m`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct View {
    pub log_gain: [f32; 4],
    pub bias: [f32; 4],
    /// A unit quaternion, its real part last.
    pub rotation: [f32; 4],
    pub translation_m: [f32; 4],
}

/// Adam's state of one parameter.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Moments {
    pub mean: f32,
    pub square: f32,
}

/// One layer of the colour network, for the gradient of its weights.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct LayerParams {
    /// Quads of inputs and of outputs of a sample.
    pub input_quads: u32,
    pub output_quads: u32,
    /// Shares that the samples are divided into, each with weight gradients of its own.
    pub shares: u32,
    /// Blocks of all weights, and where the layer's begin.
    pub weight_blocks: u32,
    pub first_block: u32,
    /// Where the biases' blocks begin; 0 for a layer whose bias is the weight of an input.
    pub first_bias: u32,
}

/// Where a stored brick lies.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct BrickPlace {
    /// Brick position within its level.
    pub position: [u32; 3],
    pub level: u32,
}
