// Gradients by the colour network's neurons and features; one thread a sample, as many times as it takes.

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
fn network_backward(
    @builtin(global_invocation_id) id: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
) {
    let count = counters[COLORED_COUNT];
    for (var slot = id.x; slot < count; slot += groups.x * WORKGROUP_SIZE) {
        backward(slot);
    }
}

fn backward(slot: u32) {
    let zero = vec4<f32>(0.0);
    // Through the logistic: c (1 - c).
    let color = slot_colors[slot];
    let by_out = slot_color_gradients[slot] * color * (1.0 - color);
    slot_color_gradients[slot] = by_out;
    let first = slot * WIDTH_BLOCKS;
    var by_b: Hidden;
    for (var row = 0u; row < WIDTH_BLOCKS; row++) {
        let gradient = select(zero, by_out * layer_3[row], hidden_b[first + row] > zero);
        by_b[row] = gradient;
        gradients_b[first + row] = gradient;
    }
    var by_features: array<vec4<f32>, FEATURE_BLOCKS>;
    for (var row = 0u; row < WIDTH_BLOCKS; row++) {
        let gradient = select(zero, back_to_hidden(row, &by_b), hidden_a[first + row] > zero);
        gradients_a[first + row] = gradient;
        let w = row * INPUT_BLOCKS;
        by_features[0] += gradient * layer_1[w];
        by_features[1] += gradient * layer_1[w + 1u];
        by_features[2] += gradient * layer_1[w + 2u];
    }
    slot_gradients[3u * slot] = by_features[0];
    slot_gradients[3u * slot + 1u] = by_features[1];
    slot_gradients[3u * slot + 2u] = by_features[2];
}

// Gradient by four neurons of the first hidden layer.
fn back_to_hidden(row: u32, by_b: ptr<function, Hidden>) -> vec4<f32> {
    var sum = four_back(row, by_b, 0u);
    if WIDTH_BLOCKS >= 8u {
        sum += four_back(row, by_b, 4u);
    }
    if WIDTH_BLOCKS >= 16u {
        sum += four_back(row, by_b, 8u);
        sum += four_back(row, by_b, 12u);
    }
    if WIDTH_BLOCKS >= 32u {
        sum += four_back(row, by_b, 16u);
        sum += four_back(row, by_b, 20u);
        sum += four_back(row, by_b, 24u);
        sum += four_back(row, by_b, 28u);
    }
    return sum;
}

fn four_back(row: u32, by_b: ptr<function, Hidden>, at: u32) -> vec4<f32> {
    var sum = (*by_b)[at] * layer_2[at * WIDTH_BLOCKS + row];
    sum += (*by_b)[at + 1u] * layer_2[(at + 1u) * WIDTH_BLOCKS + row];
    sum += (*by_b)[at + 2u] * layer_2[(at + 2u) * WIDTH_BLOCKS + row];
    sum += (*by_b)[at + 3u] * layer_2[(at + 3u) * WIDTH_BLOCKS + row];
    return sum;
}
