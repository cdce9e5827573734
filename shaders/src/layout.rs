//! Host mirrors of the structs in `wgsl/`, field by field in the same order; `tests/layout.rs` compares them with naga's offsets.

use bytemuck::{Pod, Zeroable};

/// One lattice level of a density pyramid; node (i, j, k) lies at `origin + (i, j, k) * voxel_m`, metres, local frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Level {
    pub origin: [f32; 3],
    pub voxel_m: f32,
    /// Bricks along x, y and z.
    pub bricks: [u32; 3],
    /// Where the level's dense brick index starts in the index buffer.
    pub index_start: u32,
}

/// A ray in the field's local frame; `direction` is unit length, distances are metres.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Ray {
    pub origin: [f32; 3],
    pub t_near: f32,
    pub direction: [f32; 3],
    pub t_far: f32,
}

/// What marching found on one ray.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct RaySummary {
    /// Optical depth: sum of sigma * delta.
    pub tau: f32,
    /// Sum of the weights, `1 - exp(-tau)`.
    pub accumulation: f32,
    /// Sum of weight * t in metres: the expected distance times the accumulation.
    pub depth_m: f32,
    pub sample_count: u32,
}

/// One sample on a ray.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct RaySample {
    /// Distance of the middle of the interval, metres.
    pub t: f32,
    /// Length of the interval, metres.
    pub delta: f32,
    /// Density at the middle, 1/m.
    pub sigma: f32,
}

/// Parameters of `march_density`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct MarchParams {
    /// Length in metres that raw densities are activated for.
    pub base_voxel_m: f32,
    pub act_shift: f32,
    /// Marching ends after the sample that brings the optical depth above this.
    pub stop_tau: f32,
    /// Interval length, metres.
    pub step_m: f32,
    pub level_count: u32,
    pub ray_count: u32,
    /// Samples kept per ray.
    pub sample_capacity: u32,
    /// Workgroups along x of the dispatch.
    pub groups_x: u32,
}
