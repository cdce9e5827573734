// Node lookup and trilinear interpolation in a pyramid of brick-sparse lattices.

// Raw density at a point, and whether any level stores a brick there.
struct RawDensity {
    raw: f32,
    stored: bool,
}

// Sum of the levels' trilinear interpolations.
fn raw_density(point: vec3<f32>) -> RawDensity {
    var sum = RawDensity(0.0, false);
    for (var l = 0u; l < params.level_count; l++) {
        let level = level_density(levels[l], point);
        sum.raw += level.raw;
        sum.stored = sum.stored || level.stored;
    }
    return sum;
}

// One level; zero outside of it.
fn level_density(level: Level, point: vec3<f32>) -> RawDensity {
    var sum = RawDensity(0.0, false);
    let position = (point - level.origin_m) * (1.0 / level.voxel_m);
    let limit = vec3<f32>(level.bricks * BRICK_SIDE);
    // Written so that NaN is outside.
    if !(all(position >= vec3<f32>(0.0)) && all(position < limit)) {
        return sum;
    }
    let base = vec3<u32>(position);
    let f = position - vec3<f32>(base);
    for (var corner = 0u; corner < 8u; corner++) {
        let step = vec3<u32>(corner & 1u, (corner >> 1u) & 1u, corner >> 2u);
        let weight = select(1.0 - f, f, step == vec3<u32>(1u));
        let node = base + step;
        let brick = stored_brick(level, node / BRICK_SIDE);
        sum.stored = sum.stored || brick != 0u;
        sum.raw += node_density(brick, node % BRICK_SIDE) * (weight.x * (weight.y * weight.z));
    }
    return sum;
}

// Stored brick at a brick position; 0 is the null brick. The index has one more cell per axis than the level, always null.
fn stored_brick(level: Level, position: vec3<u32>) -> u32 {
    let cells = level.bricks + 1u;
    return brick_index[level.index_start + position.x + cells.x * (position.y + cells.y * position.z)];
}

// Value of one node of a brick.
fn node_density(brick: u32, within: vec3<u32>) -> f32 {
    let offset = within.x + BRICK_SIDE * (within.y + BRICK_SIDE * within.z);
    return density[brick * (BRICK_SIDE * BRICK_SIDE * BRICK_SIDE) + offset];
}
