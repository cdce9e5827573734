// The colour network of four samples at once, for adapters on which reading a weight costs as much as using it.
//
// A Tile's column is a sample, its rows four neurons. Weights and terms are as in network.wgsl.

// Hidden width in quads: 4, 8, 16 or 32.
override WIDTH_BLOCKS: u32;

const INPUT_BLOCKS: u32 = 10u;
const FEATURE_BLOCKS: u32 = 3u;
const MAX_WIDTH_BLOCKS: u32 = 32u;

alias Tile = mat4x4<f32>;
alias Inputs = array<Tile, INPUT_BLOCKS>;
alias Hidden = array<Tile, MAX_WIDTH_BLOCKS>;

// sum + weights * x.
fn multiply_add(sum: Tile, w: Tile, x: Tile) -> Tile {
    return Tile(
        sum[0] + w[0] * x[0].x + w[1] * x[0].y + w[2] * x[0].z + w[3] * x[0].w,
        sum[1] + w[0] * x[1].x + w[1] * x[1].y + w[2] * x[1].z + w[3] * x[1].w,
        sum[2] + w[0] * x[2].x + w[1] * x[2].y + w[2] * x[2].z + w[3] * x[2].w,
        sum[3] + w[0] * x[3].x + w[1] * x[3].y + w[2] * x[3].z + w[3] * x[3].w,
    );
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

fn rectified(x: Tile) -> Tile {
    let zero = vec4<f32>(0.0);
    return Tile(max(x[0], zero), max(x[1], zero), max(x[2], zero), max(x[3], zero));
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

// The same four biases for every sample.
fn for_all_samples(bias: vec4<f32>) -> Tile {
    return Tile(bias, bias, bias, bias);
}

// Four neurons of the first hidden layer.
fn hidden_1(row: u32, x: ptr<function, Inputs>) -> Tile {
    let w = row * INPUT_BLOCKS;
    var sum = multiply_add(Tile(), layer_1[w], (*x)[0]);
    sum = multiply_add(sum, layer_1[w + 1u], (*x)[1]);
    sum = multiply_add(sum, layer_1[w + 2u], (*x)[2]);
    sum = multiply_add(sum, layer_1[w + 3u], (*x)[3]);
    sum = multiply_add(sum, layer_1[w + 4u], (*x)[4]);
    sum = multiply_add(sum, layer_1[w + 5u], (*x)[5]);
    sum = multiply_add(sum, layer_1[w + 6u], (*x)[6]);
    sum = multiply_add(sum, layer_1[w + 7u], (*x)[7]);
    sum = multiply_add(sum, layer_1[w + 8u], (*x)[8]);
    return rectified(multiply_add(sum, layer_1[w + 9u], (*x)[9]));
}

// Four terms of a row of layer 2 from quad `at` on.
fn four_of_row(sum: Tile, w: u32, x: ptr<function, Hidden>, at: u32) -> Tile {
    var next = multiply_add(sum, layer_2[w + at], (*x)[at]);
    next = multiply_add(next, layer_2[w + at + 1u], (*x)[at + 1u]);
    next = multiply_add(next, layer_2[w + at + 2u], (*x)[at + 2u]);
    return multiply_add(next, layer_2[w + at + 3u], (*x)[at + 3u]);
}

// Four neurons of the second hidden layer.
fn hidden_2(row: u32, x: ptr<function, Hidden>) -> Tile {
    let w = row * WIDTH_BLOCKS;
    var sum = four_of_row(for_all_samples(layer_3[WIDTH_BLOCKS + row][0]), w, x, 0u);
    if WIDTH_BLOCKS >= 8u {
        sum = four_of_row(sum, w, x, 4u);
    }
    if WIDTH_BLOCKS >= 16u {
        sum = four_of_row(sum, w, x, 8u);
        sum = four_of_row(sum, w, x, 12u);
    }
    if WIDTH_BLOCKS >= 32u {
        sum = four_of_row(sum, w, x, 16u);
        sum = four_of_row(sum, w, x, 20u);
        sum = four_of_row(sum, w, x, 24u);
        sum = four_of_row(sum, w, x, 28u);
    }
    return rectified(sum);
}

// Gradient by four neurons of the first hidden layer.
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

// sRGB from the sums of the last layer; the fourth component is 0.
fn color_of(sum: vec4<f32>) -> vec4<f32> {
    return vec4<f32>(sigmoid(sum.x), sigmoid(sum.y), sigmoid(sum.z), 0.0);
}
