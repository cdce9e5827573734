//! Host mirrors of the structs of dense grids in `wgsl/grid.wgsl`, as those in [`crate::layout`].

use bytemuck::{Pod, Zeroable};

/// Parameters of a dense grid's kernels for one batch of a step's rays.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct GridParams {
    /// Nodes per axis, at least 2.
    pub nodes: [u32; 3],
    /// Rays of the batch, and the batch's first within the step.
    pub ray_count: u32,
    /// Bricks per axis.
    pub bricks: [u32; 3],
    pub first_ray: u32,
    pub low_m: [f32; 3],
    /// Distance between samples.
    pub step_m: f32,
    pub high_m: [f32; 3],
    /// Samples that are stored for each ray.
    pub sample_capacity: u32,
    pub nodes_per_m: [f32; 3],
    /// Added to the raw density before the activation.
    pub act_shift: f32,
    /// sRGB behind the scene.
    pub backdrop: [f32; 3],
    /// Length of a step in base voxels.
    pub interval: f32,
    /// Raw densities up to here are not sampled.
    pub raw_min: f32,
    /// Samples of no more weight are not coloured.
    pub weight_min: f32,
    /// One over the rays of a step.
    pub ray_share: f32,
    pub entropy: f32,
    pub sample_color: f32,
    /// Of Adam, its bias corrections included.
    pub density_rate: f32,
    pub color_rate: f32,
    /// Counted from 1.
    pub step: u32,
    /// 1: values without gradient keep their moments and stay.
    pub is_masked: u32,
    /// 1: the density's rate has a factor at every node.
    pub has_shares: u32,
    /// The bricks that are moved.
    pub first_brick: u32,
    pub brick_end: u32,
}

/// A ray of a training image.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct PixelRay {
    pub origin_m: [f32; 3],
    /// Where sampling may begin, metres along the ray.
    pub near_m: f32,
    pub direction: [f32; 3],
    /// Marching ends once the optical depth exceeds this.
    pub stop_tau: f32,
    /// sRGB.
    pub color: [f32; 3],
    pub padding: u32,
}

/// A block of 8^3 nodes of the mask.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct MaskBlock {
    /// Bit `(z * 8 + y) * 8 + x` of the 512 bits says that something may be nearest to node (x, y, z).
    pub bits: [u32; 16],
    /// 1 if any bit is set.
    pub any: u32,
}

/// A sample of enough opacity to take part.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct GridSample {
    /// Node coordinates.
    pub q: [f32; 3],
    /// Optical depth of its interval, and its derivative by the raw density.
    pub tau: f32,
    pub slope: f32,
    pub weight: f32,
    /// Its slot in the colour batch; `u32::MAX` for none.
    pub slot: u32,
    pub padding: u32,
}

/// What marching found on one ray.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct RayLight {
    /// Light that is left at its end.
    pub left: f32,
    pub sample_count: u32,
    pub first_point: u32,
}

/// A coloured sample.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct GridSlot {
    pub ray: u32,
    pub sample: u32,
}

/// A sample's place and gradient.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct GridPoint {
    /// Node coordinates.
    pub q: [f32; 3],
    /// By the raw density there.
    pub raw: f32,
    /// Row of the colour gradients; `u32::MAX` for none.
    pub slot: u32,
    pub padding: [u32; 3],
}
