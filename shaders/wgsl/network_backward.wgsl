// Gradients of the colour network by its inputs and weights; one thread four samples, as many times as it takes.
//
// A thread computes its samples' activations again, which costs less than writing and reading them, and sums the weights'
// gradients over all its samples in memory of its own. That suits processors with few threads and large caches.

override WORKGROUP_SIZE: u32;

// Blocks of all weights of the widest network.
const MAX_WEIGHT_BLOCKS: u32 = 1409u;

alias WeightSums = array<Tile, MAX_WEIGHT_BLOCKS>;

@group(0) @binding(0) var<uniform> layer_1: array<mat4x4<f32>, 320>;
@group(0) @binding(1) var<uniform> layer_2: array<mat4x4<f32>, 1024>;
@group(0) @binding(2) var<uniform> layer_3: array<mat4x4<f32>, 65>;
@group(0) @binding(3) var<storage, read> rays: array<Ray>;
@group(0) @binding(4) var<storage, read> slot_samples: array<SlotSample>;
@group(0) @binding(5) var<storage, read> counters: array<u32>;
@group(0) @binding(6) var<storage, read> slot_color_gradients: array<vec4<f32>>;
// Features before, their gradients after.
@group(0) @binding(7) var<storage, read_write> slot_features: array<vec4<f32>>;
// Every thread's sums, one thread after the other.
@group(0) @binding(8) var<storage, read_write> weight_gradients: array<mat4x4<f32>>;

@compute @workgroup_size(WORKGROUP_SIZE)
fn network_backward(
    @builtin(global_invocation_id) id: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
) {
    let count = counters[COLORED_COUNT];
    var sums: WeightSums;
    for (var slot = 4u * id.x; slot < count; slot += 4u * groups.x * WORKGROUP_SIZE) {
        differentiate_four(slot, count, &sums);
    }
    let first = id.x * weight_blocks();
    for (var b = 0u; b < weight_blocks(); b++) {
        weight_gradients[first + b] = sum_of(weight_gradients[first + b], sums[b]);
    }
}

fn differentiate_four(slot: u32, count: u32, sums: ptr<function, WeightSums>) {
    var inputs: Inputs;
    inputs_of_slots(slot, count - 1u, &inputs);
    var hidden_a: Hidden;
    for (var row = 0u; row < WIDTH_BLOCKS; row++) {
        hidden_a[row] = hidden_1(row, &inputs);
    }
    var hidden_b: Hidden;
    var out = for_all_samples(layer_3[2u * WIDTH_BLOCKS][0]);
    for (var row = 0u; row < WIDTH_BLOCKS; row++) {
        let neurons = hidden_2(row, &hidden_a);
        hidden_b[row] = neurons;
        out = multiply_add(out, layer_3[row], neurons);
    }
    let by_out = by_sums(slot, count, colors_of(out));
    let biases = layer_3_at() + 2u * WIDTH_BLOCKS;
    (*sums)[biases] = sum_of((*sums)[biases], bias_gradient(by_out));
    var by_b: Hidden;
    for (var row = 0u; row < WIDTH_BLOCKS; row++) {
        let neurons = hidden_b[row];
        (*sums)[layer_3_at() + row] = add_outer((*sums)[layer_3_at() + row], by_out, neurons);
        let gradient = where_positive(neurons, multiply_back(Tile(), layer_3[row], by_out));
        let bias = layer_3_at() + WIDTH_BLOCKS + row;
        (*sums)[bias] = sum_of((*sums)[bias], bias_gradient(gradient));
        by_b[row] = gradient;
    }
    var by_features: array<Tile, FEATURE_BLOCKS>;
    for (var row = 0u; row < WIDTH_BLOCKS; row++) {
        let neurons = hidden_a[row];
        for (var next = 0u; next < WIDTH_BLOCKS; next++) {
            let at = layer_2_at() + next * WIDTH_BLOCKS + row;
            (*sums)[at] = add_outer((*sums)[at], by_b[next], neurons);
        }
        let gradient = where_positive(neurons, back_to_hidden(row, &by_b));
        let first = row * INPUT_BLOCKS;
        for (var input = 0u; input < INPUT_BLOCKS; input++) {
            (*sums)[first + input] = add_outer((*sums)[first + input], gradient, inputs[input]);
        }
        by_features[0] = multiply_back(by_features[0], layer_1[first], gradient);
        by_features[1] = multiply_back(by_features[1], layer_1[first + 1u], gradient);
        by_features[2] = multiply_back(by_features[2], layer_1[first + 2u], gradient);
    }
    for (var s = 0u; s < min(4u, count - slot); s++) {
        slot_features[3u * (slot + s)] = by_features[0][s];
        slot_features[3u * (slot + s) + 1u] = by_features[1][s];
        slot_features[3u * (slot + s) + 2u] = by_features[2][s];
    }
}

// Gradient before the logistic, c (1 - c) of the one by the colours; none for slots past the last.
fn by_sums(slot: u32, count: u32, colors: Tile) -> Tile {
    let last = count - 1u;
    return Tile(
        by_sum(slot, last, colors[0]),
        by_sum(slot + 1u, last, colors[1]),
        by_sum(slot + 2u, last, colors[2]),
        by_sum(slot + 3u, last, colors[3]),
    );
}

fn by_sum(slot: u32, last: u32, color: vec4<f32>) -> vec4<f32> {
    let by_color = slot_color_gradients[min(slot, last)];
    return select(vec4<f32>(0.0), by_color * color * (1.0 - color), slot <= last);
}

// Gradient by four neurons of the first hidden layer's outputs.
fn back_to_hidden(row: u32, by_b: ptr<function, Hidden>) -> Tile {
    var sum = four_back(Tile(), row, by_b, 0u);
    if WIDTH_BLOCKS >= 8u {
        sum = four_back(sum, row, by_b, 4u);
    }
    if WIDTH_BLOCKS >= 16u {
        sum = four_back(sum, row, by_b, 8u);
        sum = four_back(sum, row, by_b, 12u);
    }
    if WIDTH_BLOCKS >= 32u {
        sum = four_back(sum, row, by_b, 16u);
        sum = four_back(sum, row, by_b, 20u);
        sum = four_back(sum, row, by_b, 24u);
        sum = four_back(sum, row, by_b, 28u);
    }
    return sum;
}

fn four_back(sum: Tile, row: u32, by_b: ptr<function, Hidden>, at: u32) -> Tile {
    var next = multiply_back(sum, layer_2[at * WIDTH_BLOCKS + row], (*by_b)[at]);
    next = multiply_back(next, layer_2[(at + 1u) * WIDTH_BLOCKS + row], (*by_b)[at + 1u]);
    next = multiply_back(next, layer_2[(at + 2u) * WIDTH_BLOCKS + row], (*by_b)[at + 2u]);
    return multiply_back(next, layer_2[(at + 3u) * WIDTH_BLOCKS + row], (*by_b)[at + 3u]);
}

// sum + transposed weights * gradient.
fn multiply_back(sum: Tile, w: Tile, gradient: Tile) -> Tile {
    return Tile(
        sum[0] + gradient[0] * w,
        sum[1] + gradient[1] * w,
        sum[2] + gradient[2] * w,
        sum[3] + gradient[3] * w,
    );
}

// sum + gradient * transposed x: the weights' gradient, summed over the samples.
fn add_outer(sum: Tile, gradient: Tile, x: Tile) -> Tile {
    return Tile(
        sum[0] + gradient[0] * x[0].x + gradient[1] * x[1].x + gradient[2] * x[2].x + gradient[3] * x[3].x,
        sum[1] + gradient[0] * x[0].y + gradient[1] * x[1].y + gradient[2] * x[2].y + gradient[3] * x[3].y,
        sum[2] + gradient[0] * x[0].z + gradient[1] * x[1].z + gradient[2] * x[2].z + gradient[3] * x[3].z,
        sum[3] + gradient[0] * x[0].w + gradient[1] * x[1].w + gradient[2] * x[2].w + gradient[3] * x[3].w,
    );
}

// The samples' sum in the first column, where biases are.
fn bias_gradient(gradient: Tile) -> Tile {
    let zero = vec4<f32>(0.0);
    return Tile(gradient[0] + gradient[1] + gradient[2] + gradient[3], zero, zero, zero);
}

fn sum_of(a: Tile, b: Tile) -> Tile {
    return Tile(a[0] + b[0], a[1] + b[1], a[2] + b[2], a[3] + b[3]);
}

// The gradient where the neuron was active.
fn where_positive(neurons: Tile, gradient: Tile) -> Tile {
    let zero = vec4<f32>(0.0);
    return Tile(
        select(zero, gradient[0], neurons[0] > zero),
        select(zero, gradient[1], neurons[1] > zero),
        select(zero, gradient[2], neurons[2] > zero),
        select(zero, gradient[3], neurons[3] > zero),
    );
}
