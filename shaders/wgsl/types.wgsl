// Records shared with the host: the host's mirror of each struct is in src/layout.rs, checked against this file.

// Nodes along one edge of a brick; a brick holds BRICK_EDGE^3 node values, x fastest.
override BRICK_EDGE: u32;
// Entry of the brick index where no brick is allocated: its nodes are zero.
override ABSENT_BRICK: u32;

// One lattice level of a density pyramid. Node (i, j, k) of the level lies at origin + (i, j, k) * voxel_m.
struct Level {
    origin: vec3<f32>,
    voxel_m: f32,
    // Bricks along x, y and z.
    bricks: vec3<u32>,
    // Where the level's dense brick index starts in brick_index.
    index_start: u32,
}

// A ray in the field's local frame; distances are metres along the unit direction.
struct Ray {
    origin: vec3<f32>,
    t_near: f32,
    direction: vec3<f32>,
    t_far: f32,
}

// What marching found on one ray.
struct RaySummary {
    // Optical depth: sum of sigma * delta.
    tau: f32,
    // Sum of the weights, 1 - exp(-tau).
    accumulation: f32,
    // Sum of weight * t: the expected distance times the accumulation, in metres.
    depth_m: f32,
    // Samples recorded for the ray; later kernels read it and never decide again.
    sample_count: u32,
}

// One sample on a ray.
struct RaySample {
    // Distance of the middle of the interval, metres.
    t: f32,
    // Length of the interval, metres.
    delta: f32,
    // Density at the middle, 1/m.
    sigma: f32,
}
