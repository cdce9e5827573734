// Total variation of one part's touched bricks: adds its gradients where the losses' were, which are 0 by then; one workgroup a brick, as
// many as it takes. Takes the neighbours that one part holds, the same or another.
//
// DVGO's: a node's gradient is a sixth of the sum over its six neighbours of clamp(v - v_n, -1, 1). Where nothing is stored there
// is no neighbour.

override WORKGROUP_SIZE: u32;

@group(0) @binding(0) var<uniform> params: TrainParams;
@group(0) @binding(1) var<uniform> part: PartParams;
// Of the neighbours.
@group(0) @binding(2) var<uniform> other_part: PartParams;
@group(0) @binding(3) var<storage, read> levels: array<Level>;
@group(0) @binding(4) var<storage, read> brick_index: array<u32>;
@group(0) @binding(5) var<storage, read> brick_places: array<BrickPlace>;
@group(0) @binding(6) var<storage, read> touched_bricks: array<u32>;
@group(0) @binding(7) var<storage, read> density: array<f32>;
@group(0) @binding(8) var<storage, read> features_a: array<vec4<f32>>;
@group(0) @binding(9) var<storage, read> features_b: array<vec4<f32>>;
@group(0) @binding(10) var<storage, read> features_c: array<vec4<f32>>;
@group(0) @binding(11) var<storage, read> other_density: array<f32>;
@group(0) @binding(12) var<storage, read> other_features_a: array<vec4<f32>>;
@group(0) @binding(13) var<storage, read> other_features_b: array<vec4<f32>>;
@group(0) @binding(14) var<storage, read> other_features_c: array<vec4<f32>>;
@group(0) @binding(15) var<storage, read_write> density_gradients: array<f32>;
@group(0) @binding(16) var<storage, read_write> gradients_a: array<vec4<f32>>;
@group(0) @binding(17) var<storage, read_write> gradients_b: array<vec4<f32>>;
@group(0) @binding(18) var<storage, read_write> gradients_c: array<vec4<f32>>;

@compute @workgroup_size(WORKGROUP_SIZE)
fn brick_variation(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(local_invocation_index) thread: u32,
    @builtin(num_workgroups) groups: vec3<u32>,
) {
    let end = min(touched_bricks[0], params.touched_end);
    for (var i = params.first_touched + group.x; i < end; i += groups.x) {
        let brick = touched_bricks[1u + i];
        // Wraps for bricks of the parts before: they are then beyond this one.
        if brick * NODES_PER_BRICK - part.first_node >= part.node_count {
            continue;
        }
        for (var within = thread; within < NODES_PER_BRICK; within += WORKGROUP_SIZE) {
            vary_node(brick, within);
        }
    }
}

fn vary_node(brick: u32, within: u32) {
    let node = brick * NODES_PER_BRICK + within - part.first_node;
    let at = vec3<u32>(within, within / BRICK_SIDE, within / (BRICK_SIDE * BRICK_SIDE)) % BRICK_SIDE;
    let own_density = density[node + part.first_node - part.first_density];
    var by_density = 0.0;
    var by_a = vec4<f32>(0.0);
    var by_b = vec4<f32>(0.0);
    var by_c = vec4<f32>(0.0);
    for (var side = 0u; side < 6u; side++) {
        let neighbour = neighbour_of(brick, at, side / 2u, side % 2u == 1u);
        let other = neighbour - other_part.first_node;
        if neighbour == 0u || other >= other_part.node_count {
            continue;
        }
        by_density += clamp(own_density - other_density[neighbour - other_part.first_density], -1.0, 1.0) / 6.0;
        if params.feature_variation_rate > 0.0 {
            by_a += sixth(features_a[node] - other_features_a[other]);
            by_b += sixth(features_b[node] - other_features_b[other]);
            by_c += sixth(features_c[node] - other_features_c[other]);
        }
    }
    density_gradients[node] += by_density;
    if params.feature_variation_rate > 0.0 {
        gradients_a[node] += by_a;
        gradients_b[node] += by_b;
        gradients_c[node] += by_c;
    }
}

fn sixth(difference: vec4<f32>) -> vec4<f32> {
    return clamp(difference, vec4<f32>(-1.0), vec4<f32>(1.0)) / 6.0;
}

// The node before or after one along an axis; 0, a node of the null brick, where nothing is stored.
fn neighbour_of(brick: u32, at: vec3<u32>, axis: u32, is_upper: bool) -> u32 {
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
