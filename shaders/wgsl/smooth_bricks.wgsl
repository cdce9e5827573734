// Moves the nodes of one part's touched bricks against the gradients of their variation and clears those; one workgroup a brick, as
// many as it takes. By itself and not through the optimiser, whose normalisation would undo the variation's weight.

override WORKGROUP_SIZE: u32;

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

@compute @workgroup_size(WORKGROUP_SIZE)
fn smooth_bricks(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(local_invocation_index) thread: u32,
    @builtin(num_workgroups) groups: vec3<u32>,
) {
    // Nothing moves once a step's sums were not finite.
    let factor = select(0.0, 1.0, state.diverged == 0u);
    let end = min(touched_bricks[0], params.touched_end);
    for (var i = params.first_touched + group.x; i < end; i += groups.x) {
        let first = touched_bricks[1u + i] * NODES_PER_BRICK;
        // Wraps for bricks of the parts before: they are then beyond this one.
        if first - part.first_node >= part.node_count {
            continue;
        }
        for (var within = thread; within < NODES_PER_BRICK; within += WORKGROUP_SIZE) {
            smooth_node(first + within - part.first_node, first + within - part.first_density, factor);
        }
    }
}

// A node's number within the part, and within the binding of the densities.
fn smooth_node(node: u32, density_at: u32, factor: f32) {
    density[density_at] -= factor * params.density_variation_rate * density_gradients[node];
    density_gradients[node] = 0.0;
    if params.feature_variation_rate > 0.0 {
        let rate = factor * params.feature_variation_rate;
        features_a[node] -= rate * gradients_a[node];
        features_b[node] -= rate * gradients_b[node];
        features_c[node] -= rate * gradients_c[node];
        gradients_a[node] = vec4<f32>(0.0);
        gradients_b[node] = vec4<f32>(0.0);
        gradients_c[node] = vec4<f32>(0.0);
    }
}
