//! Host mirrors of the structs in `wgsl/scene.wgsl`, as in [`crate::layout`].

use bytemuck::{Pod, Zeroable};

/// A camera seen from a field's frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct EyeParams {
    /// Columns of the rotation from the camera's frame to the field's.
    pub right: [f32; 3],
    pub focal_x_px: f32,
    pub down: [f32; 3],
    pub focal_y_px: f32,
    pub forward: [f32; 3],
    pub principal_x_px: f32,
    pub origin_m: [f32; 3],
    pub principal_y_px: f32,
    /// k1, k2, p1, p2 of Brown and Conrady, k1 to k4 of Kannala and Brandt.
    pub k: [f32; 4],
    /// k3 of Brown and Conrady.
    pub k3: f32,
    /// 0: none; 1: Brown and Conrady; 2: Kannala and Brandt.
    pub distortion: u32,
    pub stop_tau: f32,
    pub first_ray: u32,
    pub ray_count: u32,
    /// Workgroups along x of the dispatch.
    pub groups_x: u32,
    pub padding: [u32; 2],
}

/// A ray through a part of a pixel: part `sub` of `side` x `side`, row by row.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct RayRequest {
    pub x: u32,
    pub y: u32,
    pub sub: u32,
    pub side: u32,
}

/// Parameters of the scene's kernels. A list is what one ray meets of one field.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct SceneParams {
    /// The object's colours become `gain * color + offset`.
    pub tone_gain: [f32; 3],
    /// Nothing of the object is below this height of its frame, metres.
    pub lowest_m: f32,
    pub tone_offset: [f32; 3],
    /// Samples of less weight get no colour of their own.
    pub min_weight: f32,
    /// First list of the dispatch, and how many.
    pub first: u32,
    pub count: u32,
    /// Workgroups along x of the dispatch.
    pub groups_x: u32,
    /// Samples stored for each list, for each pair where both are in use.
    pub capacity: u32,
    /// Samples stored for each ray's own list.
    pub ray_capacity: u32,
    pub slot_capacity: u32,
    pub sky_grid_count: u32,
    pub object: u32,
    /// The background ends at this optical depth, and at the other where an object is on the ray.
    pub stop_tau: f32,
    pub stop_tau_through_object: f32,
    /// Optical depth that takes half of the light.
    pub half_tau: f32,
    pub padding: u32,
}

/// The cuboid of an object in its own frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct ObjectBox {
    pub half_m: [f32; 3],
    /// Background above this height within the cuboid is haze, metres.
    pub floor_m: f32,
}

/// Pairs of a ray: a range of the pairs' order.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct RayPairs {
    pub start: u32,
    pub count: u32,
}

/// What a ray meets of one field.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct SampleList {
    pub count: u32,
    /// Sample that merging has come to.
    pub cursor: u32,
    pub object: u32,
    /// Sum of the samples' weights in the merged scene.
    pub total_weight: f32,
    /// What the object would take of the light alone, 0..1.
    pub alone: f32,
}

/// A sample's place on its ray and its weight in the merged scene.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Weighted {
    pub t: f32,
    pub weight: f32,
}

/// What a ray adds up to.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct RayHit {
    pub transmittance: f32,
    /// Distance at which half of the light is gone, metres; below 0 where more is left.
    pub half_t: f32,
    /// The same of the background alone.
    pub background_half_t: f32,
    /// Camera z per metre along the ray.
    pub z_per_m: f32,
}

/// Slots that hold a list's coloured samples.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct SlotRange {
    pub first: u32,
    pub count: u32,
}
