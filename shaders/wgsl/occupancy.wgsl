// Which cells of space can hold density.

// Cells along each edge of a block; fixed by the width of Block.mask.
const BLOCK_SIDE: u32 = 8u;

// What a ray meets at a point: an empty cube to leave, or space to sample.
struct Space {
    occupied: bool,
    // Occupied: the largest step, metres.
    step_m: f32,
    // Empty: lower corner and edge length of a cube without density, metres.
    corner_m: vec3<f32>,
    side_m: f32,
}

fn space_at(point: vec3<f32>) -> Space {
    let position = (point - params.occupancy_origin_m) * (1.0 / params.cell_m);
    // A ray inside the box can leave it by rounding; the nearest cell then answers.
    let last = vec3<i32>(params.blocks * BLOCK_SIDE) - 1;
    let cell = vec3<u32>(clamp(vec3<i32>(floor(position)), vec3<i32>(0), last));
    let at = cell / BLOCK_SIDE;
    let stored = block_index[at.x + params.blocks.x * (at.y + params.blocks.y * at.z)];
    if stored == 0u {
        let side_m = params.cell_m * f32(BLOCK_SIDE);
        return Space(false, 0.0, params.occupancy_origin_m + vec3<f32>(at) * side_m, side_m);
    }
    let within = cell % BLOCK_SIDE;
    let bit = within.x + BLOCK_SIDE * (within.y + BLOCK_SIDE * within.z);
    if (blocks[stored].mask[bit / 32u] & (1u << (bit % 32u))) == 0u {
        return Space(false, 0.0, params.occupancy_origin_m + vec3<f32>(cell) * params.cell_m, params.cell_m);
    }
    return Space(true, blocks[stored].step_m, vec3<f32>(0.0), 0.0);
}
