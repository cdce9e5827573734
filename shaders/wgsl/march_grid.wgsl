// Samples of rays through a dense grid at a fixed pitch, their weights, and slots in the colour batch; one thread a ray.

override WORKGROUP_SIZE: u32;

// Taken off a distance to a block's face, in steps, so that rounding never skips a sample.
const STEP_SLACK: f32 = 1e-3;

@group(0) @binding(0) var<uniform> params: GridParams;
@group(0) @binding(1) var<storage, read> mask: array<MaskBlock>;
@group(0) @binding(2) var<storage, read> density: array<f32>;
@group(0) @binding(3) var<storage, read> rays: array<PixelRay>;
@group(0) @binding(4) var<storage, read_write> samples: array<GridSample>;
@group(0) @binding(5) var<storage, read_write> lights: array<RayLight>;
@group(0) @binding(6) var<storage, read_write> slots: array<GridSlot>;
@group(0) @binding(7) var<storage, read_write> counters: array<atomic<u32>>;

@compute @workgroup_size(WORKGROUP_SIZE)
fn march_grid(@builtin(global_invocation_id) id: vec3<u32>) {
    let ray = id.x;
    if ray >= params.ray_count {
        return;
    }
    let first = ray * params.sample_capacity;
    let count = march(rays[ray], first);
    var light = 1.0;
    var shown = 0u;
    for (var i = first; i < first + count; i++) {
        let weight = light * -exponential_less_one(-samples[i].tau);
        light -= weight;
        samples[i].weight = weight;
        shown += u32(weight > params.weight_min);
    }
    lights[ray] = RayLight(max(light, 0.0), count, atomicAdd(&counters[POINT_COUNT], count));
    var slot = atomicAdd(&counters[COLORED_COUNT], shown);
    atomicAdd(&counters[STEP_POINT_COUNT], count);
    atomicAdd(&counters[STEP_COLORED_COUNT], shown);
    for (var i = first; i < first + count; i++) {
        if samples[i].weight > params.weight_min {
            samples[i].slot = slot;
            slots[slot] = GridSlot(ray, i);
            slot++;
        } else {
            samples[i].slot = NO_SLOT;
        }
    }
}

// Records the samples of a ray, near to far; returns how many there are.
fn march(ray: PixelRay, first: u32) -> u32 {
    let inverse = reciprocal(ray.direction);
    let a = (params.low_m - ray.origin_m) * inverse;
    let b = (params.high_m - ray.origin_m) * inverse;
    let low = min(a, b);
    let high = max(a, b);
    let enter = max(max(max(low.x, max(low.y, low.z)), 0.0), ray.near_m);
    let leave = min(high.x, min(high.y, high.z));
    if !(enter < leave) {
        return 0u;
    }
    let start = (ray.origin_m + ray.direction * enter - params.low_m) * params.nodes_per_m;
    let step = ray.direction * params.step_m * params.nodes_per_m;
    let step_inverse = reciprocal(step);
    let total = u32(ceil((leave - enter) / params.step_m));
    let last = vec3<f32>(params.nodes - 1u);
    var count = 0u;
    var tau = 0.0;
    var number = 0u;
    while number < total && tau <= ray.stop_tau {
        let q = start + step * f32(number);
        number++;
        if !(all(q >= vec3<f32>(0.0)) && all(q <= last)) {
            continue;
        }
        let node = vec3<u32>(q + 0.5);
        let place = node / BRICK_SIDE;
        let block = (place.z * params.bricks.y + place.y) * params.bricks.x + place.x;
        if mask[block].any == 0u {
            number += steps_in_block(place, q, step_inverse, total);
            continue;
        }
        let within = node % BRICK_SIDE;
        let bit = (within.z * BRICK_SIDE + within.y) * BRICK_SIDE + within.x;
        if ((mask[block].bits[bit / 32u] >> (bit % 32u)) & 1u) == 0u {
            continue;
        }
        let raw = density_at(q);
        if raw > params.raw_min && count < params.sample_capacity {
            let x = raw + params.act_shift;
            let own = params.interval * softplus(x);
            tau += own;
            samples[first + count] = GridSample(q, own, params.interval * sigmoid(x), 0.0, NO_SLOT);
            count++;
        }
    }
    return count;
}

// Whole steps until the nearest node is in another block.
fn steps_in_block(block: vec3<u32>, q: vec3<f32>, step_inverse: vec3<f32>, total: u32) -> u32 {
    // Points whose nearest node is in the block reach half a node past its first and last.
    let low = vec3<f32>(block * BRICK_SIDE) - 0.5;
    let a = (low - q) * step_inverse;
    let b = (low + f32(BRICK_SIDE) - q) * step_inverse;
    let faces = max(a, b);
    let steps = min(faces.x, min(faces.y, faces.z)) - STEP_SLACK;
    return u32(clamp(steps, 0.0, f32(total)));
}

fn density_at(q: vec3<f32>) -> f32 {
    let cell = cell_at(q);
    let f = cell.fraction;
    let near = between(along_x(cell, 0u), along_x(cell, 2u), f.y);
    let far = between(along_x(cell, 4u), along_x(cell, 6u), f.y);
    return between(near, far, f.z);
}

// Between a corner and the next one along x.
fn along_x(cell: Cell, corner: u32) -> f32 {
    let a = density[corner_node(cell, corner)];
    let b = density[corner_node(cell, corner + 1u)];
    return between(a, b, cell.fraction.x);
}

fn between(a: f32, b: f32, t: f32) -> f32 {
    return a + t * (b - a);
}

// Componentwise 1 / v; division by zero is indeterminate in WGSL, so a zero becomes a very small number first.
fn reciprocal(v: vec3<f32>) -> vec3<f32> {
    return 1.0 / select(v, vec3<f32>(1e-30), v == vec3<f32>(0.0));
}
