// Node lookup and trilinear interpolation in a pyramid of brick-sparse lattices.

// Value of one node; nodes of absent bricks are zero.
fn node_density(level: Level, node: vec3<u32>) -> f32 {
    let brick = node / BRICK_EDGE;
    let cell = level.index_start + brick.x + level.bricks.x * (brick.y + level.bricks.y * brick.z);
    let slot = brick_index[cell];
    if slot == ABSENT_BRICK {
        return 0.0;
    }
    let inside = node % BRICK_EDGE;
    let offset = inside.x + BRICK_EDGE * (inside.y + BRICK_EDGE * inside.z);
    return density[slot * BRICK_EDGE * BRICK_EDGE * BRICK_EDGE + offset];
}

// Trilinear interpolation of one level at a point of the local frame; zero outside the level's nodes.
fn level_density(level: Level, point: vec3<f32>) -> f32 {
    let nodes = level.bricks * BRICK_EDGE;
    let position = (point - level.origin) / level.voxel_m;
    let base = floor(position);
    if any(base < vec3<f32>(0.0)) || any(base + 1.0 > vec3<f32>(nodes - 1u)) {
        return 0.0;
    }
    let f = position - base;
    let node = vec3<u32>(base);
    var value = 0.0;
    for (var corner = 0u; corner < 8u; corner++) {
        let step = vec3<u32>(corner & 1u, (corner >> 1u) & 1u, corner >> 2u);
        let weight = select(1.0 - f, f, step == vec3<u32>(1u));
        value += weight.x * weight.y * weight.z * node_density(level, node + step);
    }
    return value;
}

// Raw density at a point: the sum over the levels.
fn raw_density(point: vec3<f32>) -> f32 {
    var raw = 0.0;
    for (var l = 0u; l < params.level_count; l++) {
        raw += level_density(levels[l], point);
    }
    return raw;
}
