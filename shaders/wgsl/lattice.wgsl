// Nodes and trilinear weights in a pyramid of brick-sparse lattices.

// The eight nodes around a point and their weights; corner c has bit 0 for x, 1 for y, 2 for z. A node below NODES_PER_BRICK is
// one of the null brick: nothing is stored there, and it is 0.
struct Corners {
    nodes: array<u32, 8>,
    weights: array<f32, 8>,
    // Whether any of them is stored.
    stored: bool,
}

// Where a level stores what is around a point; all null outside of it.
fn corners_at(level: Level, point: vec3<f32>) -> Corners {
    var corners: Corners;
    let position = (point - level.origin_m) * (1.0 / level.voxel_m);
    let limit = vec3<f32>(level.bricks * BRICK_SIDE);
    // Written so that NaN is outside.
    if !(all(position >= vec3<f32>(0.0)) && all(position < limit)) {
        return corners;
    }
    let base = vec3<u32>(position);
    let f = position - vec3<f32>(base);
    for (var corner = 0u; corner < 8u; corner++) {
        let step = vec3<u32>(corner & 1u, (corner >> 1u) & 1u, corner >> 2u);
        let weight = select(1.0 - f, f, step == vec3<u32>(1u));
        let node = base + step;
        let brick = stored_brick(level, node / BRICK_SIDE);
        let within = node % BRICK_SIDE;
        corners.nodes[corner] = brick * NODES_PER_BRICK + within.x + BRICK_SIDE * (within.y + BRICK_SIDE * within.z);
        corners.weights[corner] = weight.x * (weight.y * weight.z);
        corners.stored = corners.stored || brick != 0u;
    }
    return corners;
}

// Stored brick at a brick position; 0 is the null brick. The index has one more cell per axis than the level, always null.
fn stored_brick(level: Level, position: vec3<u32>) -> u32 {
    let cells = level.bricks + 1u;
    return brick_index[level.index_start + position.x + cells.x * (position.y + cells.y * position.z)];
}
