// Records shared with the host: the host's mirror of each struct is in src/layout.rs, checked against this file.

// Nodes along one edge of a brick, and all of its nodes, x fastest.
override BRICK_SIDE: u32;
override NODES_PER_BRICK: u32;

// One lattice level of a density pyramid. Node (i, j, k) of the level lies at origin_m + (i, j, k) * voxel_m.
struct Level {
    origin_m: vec3<f32>,
    voxel_m: f32,
    // Brick positions along x, y and z.
    bricks: vec3<u32>,
    // Where the level's dense brick index starts in brick_index; its entries number the bricks of all levels together.
    index_start: u32,
}

// A range of the nodes: what no binding holds as a whole is taken part by part.
struct PartParams {
    level_count: u32,
    first_node: u32,
    node_count: u32,
    // First node of the binding that holds the part's densities, for kernels that have one.
    first_density: u32,
}

// A stored block of 8^3 occupancy cells.
struct Block {
    // Bit (z * 8 + y) * 8 + x of the 512 bits says that density may be in cell (x, y, z).
    mask: array<u32, 16>,
    // Step of a ray inside the block, metres.
    step_m: f32,
}

// A ray in the field's local frame and the part of it to march; distances are metres along the unit direction.
struct Ray {
    origin_m: vec3<f32>,
    t_min: f32,
    direction: vec3<f32>,
    t_max: f32,
    // Marching ends once tau exceeds this.
    stop_tau: f32,
    // Where in each interval the density is read, 0..1.
    phase: f32,
}

// What marching found on one ray.
struct RaySummary {
    // Optical depth: sum of sigma * dt.
    tau: f32,
    // Sum of the samples' weights.
    accumulation: f32,
    // Sum of weight * t: the expected distance times the accumulation, in metres.
    weighted_distance_m: f32,
    // Samples the ray took; later kernels read it and never decide again.
    sample_count: u32,
}

// One interval of a ray with the density at a point in it.
struct RaySample {
    // Distance from the ray's origin to the sampled point, metres.
    t: f32,
    // Length of the interval, metres.
    dt: f32,
    // Density, 1/m.
    sigma: f32,
}
