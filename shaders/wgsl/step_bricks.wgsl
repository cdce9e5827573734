// Moves the nodes of one part's touched bricks against their gradients and clears those; one workgroup a brick, as many as it takes.
//
// RMSProp with one mean square for a node's density and one for its 12 features, only where there is a gradient.

override WORKGROUP_SIZE: u32;

// Decay of the mean squares.
override DECAY: f32;
// Added to the root of a mean square, or a gradient of nothing would move a parameter by the full rate.
override EPSILON: f32;

@group(0) @binding(0) var<uniform> params: TrainParams;
@group(0) @binding(1) var<uniform> part: PartParams;
@group(0) @binding(2) var<storage, read> state: StepState;
@group(0) @binding(3) var<storage, read> touched_bricks: array<u32>;
@group(0) @binding(4) var<storage, read_write> density: array<f32>;
@group(0) @binding(5) var<storage, read_write> features_a: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read_write> features_b: array<vec4<f32>>;
@group(0) @binding(7) var<storage, read_write> features_c: array<vec4<f32>>;
@group(0) @binding(8) var<storage, read_write> density_gradients: array<f32>;
@group(0) @binding(9) var<storage, read_write> gradients_a: array<vec4<f32>>;
@group(0) @binding(10) var<storage, read_write> gradients_b: array<vec4<f32>>;
@group(0) @binding(11) var<storage, read_write> gradients_c: array<vec4<f32>>;
@group(0) @binding(12) var<storage, read_write> density_squares: array<f32>;
@group(0) @binding(13) var<storage, read_write> feature_squares: array<f32>;
@group(0) @binding(14) var<storage, read_write> brick_marks: array<u32>;

@compute @workgroup_size(WORKGROUP_SIZE)
fn step_bricks(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(local_invocation_index) thread: u32,
    @builtin(num_workgroups) groups: vec3<u32>,
) {
    let moves = state.diverged == 0u;
    let end = min(touched_bricks[0], params.touched_end);
    for (var i = params.first_touched + group.x; i < end; i += groups.x) {
        let brick = touched_bricks[1u + i];
        let first = brick * NODES_PER_BRICK;
        // Wraps for bricks of the parts before: they are then beyond this one.
        if first - part.first_node >= part.node_count {
            continue;
        }
        for (var within = thread; within < NODES_PER_BRICK; within += WORKGROUP_SIZE) {
            step_node(first + within - part.first_node, first + within - part.first_density, moves);
        }
        if thread == 0u {
            brick_marks[brick] = 0u;
        }
    }
}

// A node's number within the part, and within the binding of the densities.
fn step_node(node: u32, density_at: u32, moves: bool) {
    let by_density = density_gradients[node];
    if by_density != 0.0 {
        density_gradients[node] = 0.0;
        let mean = mean_square(density_squares[node], by_density * by_density);
        if moves {
            density_squares[node] = mean;
            density[density_at] -= params.density_rate * by_density / (sqrt(mean) + EPSILON);
        }
    }
    let a = gradients_a[node];
    let b = gradients_b[node];
    let c = gradients_c[node];
    let square = (dot(a, a) + dot(b, b) + dot(c, c)) / 12.0;
    if square != 0.0 {
        gradients_a[node] = vec4<f32>(0.0);
        gradients_b[node] = vec4<f32>(0.0);
        gradients_c[node] = vec4<f32>(0.0);
        let mean = mean_square(feature_squares[node], square);
        if moves {
            feature_squares[node] = mean;
            let rate = params.feature_rate / (sqrt(mean) + EPSILON);
            features_a[node] -= rate * a;
            features_b[node] -= rate * b;
            features_c[node] -= rate * c;
        }
    }
}

// The running mean, which starts at its first value.
fn mean_square(mean: f32, square: f32) -> f32 {
    return select(DECAY * mean + (1.0 - DECAY) * square, square, mean == 0.0);
}
