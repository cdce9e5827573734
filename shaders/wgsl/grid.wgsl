// A dense grid over a box, stored in bricks of 8^3 nodes one after the other, and the records that its training kernels share.

struct GridParams {
    // Nodes per axis, at least 2.
    nodes: vec3<u32>,
    // Rays of the batch, and the batch's first within the step.
    ray_count: u32,
    // Bricks per axis.
    bricks: vec3<u32>,
    first_ray: u32,
    low_m: vec3<f32>,
    // Distance between samples.
    step_m: f32,
    high_m: vec3<f32>,
    // Samples that are stored for each ray.
    sample_capacity: u32,
    nodes_per_m: vec3<f32>,
    // Added to the raw density before the activation.
    act_shift: f32,
    // sRGB behind the scene.
    backdrop: vec3<f32>,
    // Length of a step in base voxels.
    interval: f32,
    // Raw densities up to here are not sampled.
    raw_min: f32,
    // Samples of no more weight are not coloured.
    weight_min: f32,
    // One over the rays of a step.
    ray_share: f32,
    entropy: f32,
    sample_color: f32,
    // Of Adam, its bias corrections included.
    density_rate: f32,
    color_rate: f32,
    // Counted from 1.
    step: u32,
    // 1: values without gradient keep their moments and stay.
    is_masked: u32,
    // 1: the density's rate has a factor at every node.
    has_shares: u32,
    // The bricks that are moved.
    first_brick: u32,
    brick_end: u32,
}

// A ray of a training image.
struct PixelRay {
    origin_m: vec3<f32>,
    // Where sampling may begin, metres along the ray.
    near_m: f32,
    direction: vec3<f32>,
    // Marching ends once the optical depth exceeds this.
    stop_tau: f32,
    // sRGB.
    color: vec3<f32>,
}

// A block of 8^3 nodes of the mask.
struct MaskBlock {
    // Bit (z * 8 + y) * 8 + x of the 512 bits says that something may be nearest to node (x, y, z).
    bits: array<u32, 16>,
    // 1 if any bit is set.
    any: u32,
}

// A sample of enough opacity to take part.
struct GridSample {
    // Node coordinates.
    q: vec3<f32>,
    // Optical depth of its interval, and its derivative by the raw density.
    tau: f32,
    slope: f32,
    weight: f32,
    // Its slot in the colour batch, or NO_SLOT.
    slot: u32,
}

// What marching found on one ray.
struct RayLight {
    // Light that is left at its end.
    left: f32,
    sample_count: u32,
    first_point: u32,
}

// A coloured sample.
struct GridSlot {
    ray: u32,
    sample: u32,
}

// A sample's place and gradient.
struct GridPoint {
    // Node coordinates.
    q: vec3<f32>,
    // By the raw density there.
    raw: f32,
    // Row of the colour gradients, or NO_SLOT.
    slot: u32,
}

// The eight nodes around a point: terms per axis whose sums are the nodes' numbers, and where between them the point lies.
struct Cell {
    near: vec3<u32>,
    far: vec3<u32>,
    fraction: vec3<f32>,
}

// A node's number is the sum of the three.
fn terms(node: vec3<u32>) -> vec3<u32> {
    let row = NODES_PER_BRICK * params.bricks.x;
    let of_brick = vec3<u32>(NODES_PER_BRICK, row, row * params.bricks.y);
    let within = vec3<u32>(1u, BRICK_SIDE, BRICK_SIDE * BRICK_SIDE);
    return (node / BRICK_SIDE) * of_brick + (node % BRICK_SIDE) * within;
}

// The cell of a point in node coordinates, which lies within 0 ..= nodes - 1.
fn cell_at(q: vec3<f32>) -> Cell {
    let base = min(vec3<u32>(q), params.nodes - 2u);
    return Cell(terms(base), terms(base + 1u), q - vec3<f32>(base));
}

// Corner c has bit 0 for x, 1 for y, 2 for z.
fn is_far(corner: u32) -> vec3<bool> {
    return vec3<bool>((corner & 1u) != 0u, (corner & 2u) != 0u, (corner & 4u) != 0u);
}

fn corner_node(cell: Cell, corner: u32) -> u32 {
    let parts = select(cell.near, cell.far, is_far(corner));
    return parts.x + parts.y + parts.z;
}

// Trilinear weight of a corner.
fn corner_weight(cell: Cell, corner: u32) -> f32 {
    let along = select(1.0 - cell.fraction, cell.fraction, is_far(corner));
    return along.x * (along.y * along.z);
}
