// Records of merged rendering that its kernels share. A pair is a ray together with an object whose box it may cross; a list is
// what one ray meets of one field: the background's list of a ray, or the list of a pair.

// Where `worst` counts what a batch asked for, so that the host can make room.
const WORST_PAIR_SAMPLES: u32 = 0u;
const WORST_RAY_SAMPLES: u32 = 1u;
const WORST_SLOTS: u32 = 2u;

// EyeParams.distortion.
const BROWN_CONRADY: u32 = 1u;
const KANNALA_BRANDT: u32 = 2u;

// A camera seen from a field's frame.
struct EyeParams {
    // Columns of the rotation from the camera's frame to the field's.
    right: vec3<f32>,
    focal_x_px: f32,
    down: vec3<f32>,
    focal_y_px: f32,
    forward: vec3<f32>,
    principal_x_px: f32,
    origin_m: vec3<f32>,
    principal_y_px: f32,
    // k1, k2, p1, p2 of Brown and Conrady, k1 to k4 of Kannala and Brandt.
    k: vec4<f32>,
    // k3 of Brown and Conrady.
    k3: f32,
    distortion: u32,
    stop_tau: f32,
    first_ray: u32,
    ray_count: u32,
    // Workgroups along x of the dispatch, which is folded into two dimensions.
    groups_x: u32,
}

// A ray through a part of a pixel: part `sub` of `side` x `side`.
struct RayRequest {
    x: u32,
    y: u32,
    sub: u32,
    side: u32,
}

struct SceneParams {
    // The object's colours become gain * color + offset.
    tone_gain: vec3<f32>,
    // Nothing of the object is below this height of its frame, metres.
    lowest_m: f32,
    tone_offset: vec3<f32>,
    // Samples of less weight get no colour of their own.
    min_weight: f32,
    // First list of the dispatch, and how many.
    first: u32,
    count: u32,
    // Workgroups along x of the dispatch, which is folded into two dimensions.
    groups_x: u32,
    // Samples stored for each list, for each pair where both are in use.
    capacity: u32,
    // Samples stored for each ray's own list.
    ray_capacity: u32,
    slot_capacity: u32,
    sky_grid_count: u32,
    object: u32,
    // The background ends at this optical depth, and at the other where an object is on the ray.
    stop_tau: f32,
    stop_tau_through_object: f32,
    // Optical depth that takes half of the light.
    half_tau: f32,
}

// The cuboid of an object in its own frame.
struct ObjectBox {
    half_m: vec3<f32>,
    // Background above this height within the cuboid is haze, metres.
    floor_m: f32,
}

// Pairs of a ray: a range of `pair_order`.
struct RayPairs {
    start: u32,
    count: u32,
}

// What a ray meets of one field.
struct SampleList {
    count: u32,
    // Sample that merging has come to.
    cursor: u32,
    object: u32,
    // Sum of the samples' weights in the merged scene.
    total_weight: f32,
    // What the object would take of the light alone.
    alone: f32,
}

// A sample's place on its ray and its weight in the merged scene.
struct Weighted {
    t: f32,
    weight: f32,
}

// What a ray adds up to.
struct RayHit {
    transmittance: f32,
    // Distance at which half of the light is gone, metres; below 0 where more is left.
    half_t: f32,
    // The same of the background alone.
    background_half_t: f32,
    // Camera z per metre along the ray.
    z_per_m: f32,
}

// Slots that hold a list's coloured samples.
struct SlotRange {
    first: u32,
    count: u32,
}
