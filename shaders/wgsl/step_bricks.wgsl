// Moves the nodes of touched bricks against their gradients and clears those; one workgroup a brick, as many as it takes.
//
// RMSProp with one mean square for a node's density and one for its 12 features, only where there is a gradient.

override WORKGROUP_SIZE: u32;

// Decay of the mean squares.
const DECAY: f32 = 0.95;
// Added to the root of a mean square, or a gradient of nothing would move a parameter by the full rate.
const EPSILON: f32 = 1e-10;

@group(0) @binding(0) var<uniform> params: TrainParams;
@group(0) @binding(1) var<storage, read> state: StepState;
@group(0) @binding(2) var<storage, read> touched_bricks: array<u32>;
@group(0) @binding(3) var<storage, read_write> density: array<f32>;
@group(0) @binding(4) var<storage, read_write> features_a: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read_write> features_b: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read_write> features_c: array<vec4<f32>>;
@group(0) @binding(7) var<storage, read_write> density_gradients: array<f32>;
@group(0) @binding(8) var<storage, read_write> gradients_a: array<vec4<f32>>;
@group(0) @binding(9) var<storage, read_write> gradients_b: array<vec4<f32>>;
@group(0) @binding(10) var<storage, read_write> gradients_c: array<vec4<f32>>;
@group(0) @binding(11) var<storage, read_write> density_squares: array<f32>;
@group(0) @binding(12) var<storage, read_write> feature_squares: array<f32>;
@group(0) @binding(13) var<storage, read_write> brick_marks: array<u32>;

@compute @workgroup_size(WORKGROUP_SIZE)
fn step_bricks(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(local_invocation_index) thread: u32,
    @builtin(num_workgroups) groups: vec3<u32>,
) {
    let moves = state.diverged == 0u;
    for (var i = group.x; i < touched_bricks[0]; i += groups.x) {
        let brick = touched_bricks[1u + i];
        for (var within = thread; within < BRICK_SIDE * BRICK_SIDE * BRICK_SIDE; within += WORKGROUP_SIZE) {
            step_node(brick * BRICK_SIDE * BRICK_SIDE * BRICK_SIDE + within, moves);
        }
        if thread == 0u {
            brick_marks[brick] = 0u;
        }
    }
}

fn step_node(node: u32, moves: bool) {
    let by_density = density_gradients[node];
    if by_density != 0.0 {
        density_gradients[node] = 0.0;
        let mean = mean_square(density_squares[node], by_density * by_density);
        if moves {
            density_squares[node] = mean;
            density[node] -= params.density_rate * by_density / (sqrt(mean) + EPSILON);
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
