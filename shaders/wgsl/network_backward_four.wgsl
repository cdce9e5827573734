// network_backward with four samples a thread.

override WORKGROUP_SIZE: u32;

@group(0) @binding(0) var<uniform> layer_1: array<mat4x4<f32>, 320>;
@group(0) @binding(1) var<uniform> layer_2: array<mat4x4<f32>, 1024>;
@group(0) @binding(2) var<uniform> layer_3: array<mat4x4<f32>, 65>;
@group(0) @binding(3) var<storage, read> counters: array<u32>;
@group(0) @binding(4) var<storage, read> hidden_a: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read> hidden_b: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read> slot_colors: array<vec4<f32>>;
// By the colours before, by the sums of the last layer after.
@group(0) @binding(7) var<storage, read_write> slot_color_gradients: array<vec4<f32>>;
@group(0) @binding(8) var<storage, read_write> gradients_a: array<vec4<f32>>;
@group(0) @binding(9) var<storage, read_write> gradients_b: array<vec4<f32>>;
@group(0) @binding(10) var<storage, read_write> slot_gradients: array<vec4<f32>>;

@compute @workgroup_size(WORKGROUP_SIZE)
fn network_backward_four(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) thread: u32,
    @builtin(subgroup_invocation_id) own_lane: u32,
) {
    lane = own_lane % LANES;
    let count = counters[COLORED_COUNT];
    let step = 4u * WORKGROUP_SIZE;
    for (var first = step * group.x; first < count; first += step * groups.x) {
        backward(first + 4u * thread);
    }
}

// Slots past the last hold leavings; what comes of those is read by nobody.
fn backward(slot: u32) {
    let by_out = Tile(by_sum(slot), by_sum(slot + 1u), by_sum(slot + 2u), by_sum(slot + 3u));
    let first = slot * WIDTH_BLOCKS;
    var by_b: Hidden;
    for (var row = 0u; row < WIDTH_BLOCKS; row++) {
        let at = first + row;
        let neurons = Tile(
            hidden_b[at],
            hidden_b[at + WIDTH_BLOCKS],
            hidden_b[at + 2u * WIDTH_BLOCKS],
            hidden_b[at + 3u * WIDTH_BLOCKS],
        );
        let gradient = where_positive(neurons, multiply_back(Tile(), block_3(row), by_out));
        by_b[row] = gradient;
        gradients_b[at] = gradient[0];
        gradients_b[at + WIDTH_BLOCKS] = gradient[1];
        gradients_b[at + 2u * WIDTH_BLOCKS] = gradient[2];
        gradients_b[at + 3u * WIDTH_BLOCKS] = gradient[3];
    }
    var by_features: array<Tile, FEATURE_BLOCKS>;
    for (var row = 0u; row < WIDTH_BLOCKS; row++) {
        let at = first + row;
        let neurons = Tile(
            hidden_a[at],
            hidden_a[at + WIDTH_BLOCKS],
            hidden_a[at + 2u * WIDTH_BLOCKS],
            hidden_a[at + 3u * WIDTH_BLOCKS],
        );
        let gradient = where_positive(neurons, back_to_hidden(row, &by_b));
        gradients_a[at] = gradient[0];
        gradients_a[at + WIDTH_BLOCKS] = gradient[1];
        gradients_a[at + 2u * WIDTH_BLOCKS] = gradient[2];
        gradients_a[at + 3u * WIDTH_BLOCKS] = gradient[3];
        let w = row * INPUT_BLOCKS;
        let of_ab = columns_1(w);
        by_features[0] = multiply_back(by_features[0], low_columns(of_ab), gradient);
        by_features[1] = multiply_back(by_features[1], high_columns(of_ab), gradient);
        by_features[2] = multiply_back(by_features[2], low_columns(columns_1(w + 2u)), gradient);
    }
    for (var s = 0u; s < 4u; s++) {
        let out = 3u * (slot + s);
        slot_gradients[out] = by_features[0][s];
        slot_gradients[out + 1u] = by_features[1][s];
        slot_gradients[out + 2u] = by_features[2][s];
    }
}

// Takes a slot's colour gradient through the logistic: c (1 - c).
fn by_sum(slot: u32) -> vec4<f32> {
    let color = slot_colors[slot];
    let gradient = slot_color_gradients[slot] * color * (1.0 - color);
    slot_color_gradients[slot] = gradient;
    return gradient;
}
