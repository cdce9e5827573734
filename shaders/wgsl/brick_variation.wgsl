// Total variation of touched bricks: writes its gradients where the losses' were; one workgroup a brick, as many as it takes.
//
// DVGO's: a node's gradient is a sixth of the sum over its six neighbours of clamp(v - v_n, -1, 1). Where nothing is stored there
// is no neighbour.

override WORKGROUP_SIZE: u32;

@group(0) @binding(0) var<uniform> params: TrainParams;
@group(0) @binding(1) var<storage, read> levels: array<Level>;
@group(0) @binding(2) var<storage, read> brick_index: array<u32>;
@group(0) @binding(3) var<storage, read> brick_places: array<BrickPlace>;
@group(0) @binding(4) var<storage, read> touched_bricks: array<u32>;
@group(0) @binding(5) var<storage, read> density: array<f32>;
@group(0) @binding(6) var<storage, read> features_a: array<vec4<f32>>;
@group(0) @binding(7) var<storage, read> features_b: array<vec4<f32>>;
@group(0) @binding(8) var<storage, read> features_c: array<vec4<f32>>;
@group(0) @binding(9) var<storage, read_write> density_gradients: array<f32>;
@group(0) @binding(10) var<storage, read_write> gradients_a: array<vec4<f32>>;
@group(0) @binding(11) var<storage, read_write> gradients_b: array<vec4<f32>>;
@group(0) @binding(12) var<storage, read_write> gradients_c: array<vec4<f32>>;

@compute @workgroup_size(WORKGROUP_SIZE)
fn brick_variation(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(local_invocation_index) thread: u32,
    @builtin(num_workgroups) groups: vec3<u32>,
) {
    for (var i = group.x; i < touched_bricks[0]; i += groups.x) {
        let brick = touched_bricks[1u + i];
        for (var within = thread; within < NODES_PER_BRICK; within += WORKGROUP_SIZE) {
            vary_node(brick, within);
        }
    }
}

fn vary_node(brick: u32, within: u32) {
    let node = brick * NODES_PER_BRICK + within;
    let at = vec3<u32>(within, within / BRICK_SIDE, within / (BRICK_SIDE * BRICK_SIDE)) % BRICK_SIDE;
    var by_density = 0.0;
    var by_a = vec4<f32>(0.0);
    var by_b = vec4<f32>(0.0);
    var by_c = vec4<f32>(0.0);
    for (var side = 0u; side < 6u; side++) {
        let other = neighbour(brick, at, side / 2u, side % 2u == 1u);
        if other == 0u {
            continue;
        }
        by_density += clamp(density[node] - density[other], -1.0, 1.0) / 6.0;
        if params.feature_variation_rate > 0.0 {
            by_a += clamp(features_a[node] - features_a[other], vec4<f32>(-1.0), vec4<f32>(1.0)) / 6.0;
            by_b += clamp(features_b[node] - features_b[other], vec4<f32>(-1.0), vec4<f32>(1.0)) / 6.0;
            by_c += clamp(features_c[node] - features_c[other], vec4<f32>(-1.0), vec4<f32>(1.0)) / 6.0;
        }
    }
    density_gradients[node] = by_density;
    if params.feature_variation_rate > 0.0 {
        gradients_a[node] = by_a;
        gradients_b[node] = by_b;
        gradients_c[node] = by_c;
    }
}

// The node before or after one along an axis; 0, a node of the null brick, where nothing is stored.
fn neighbour(brick: u32, at: vec3<u32>, axis: u32, is_upper: bool) -> u32 {
    let place = brick_places[brick];
    var next = at;
    var position = place.position;
    var owner = brick;
    if is_upper {
        next[axis] = (at[axis] + 1u) % BRICK_SIDE;
    } else {
        next[axis] = (at[axis] + BRICK_SIDE - 1u) % BRICK_SIDE;
    }
    if is_upper && at[axis] == BRICK_SIDE - 1u {
        position[axis] += 1u;
        owner = stored_brick(levels[place.level], position);
    }
    if !is_upper && at[axis] == 0u {
        if position[axis] == 0u {
            return 0u;
        }
        position[axis] -= 1u;
        owner = stored_brick(levels[place.level], position);
    }
    if owner == 0u {
        return 0u;
    }
    return owner * NODES_PER_BRICK + next.x + BRICK_SIDE * (next.y + BRICK_SIDE * next.z);
}
