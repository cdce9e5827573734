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
    pub padding: [u32; 2],
}
