// The colour network rgb = sigmoid(W3 relu(W2 relu(W1 input + b1) + b2) + b3) of four samples at once, in 4x4 blocks.
//
// Activations: a Tile's column is a sample, its rows four neurons. Weights: column c belongs to input neuron c, its rows to four
// output neurons; blocks of a layer are stored one output row after the other. The bias of layer 1 is the weight of an input 1.
// Terms are written out one by one: drivers then keep activations in registers, which they do not in loops.

// Hidden width in blocks: 4, 8, 16 or 32.
override WIDTH_BLOCKS: u32;

// 12 features, then direction and 1, then sine and cosine octaves of the direction.
const INPUT_BLOCKS: u32 = 10u;
const FEATURE_BLOCKS: u32 = 3u;
const MAX_WIDTH_BLOCKS: u32 = 32u;

alias Tile = mat4x4<f32>;
alias Inputs = array<Tile, INPUT_BLOCKS>;
alias Hidden = array<Tile, MAX_WIDTH_BLOCKS>;

// Blocks of the layers when they lie one after the other; the third is its weights, then layer 2's biases, then its own.
fn layer_2_at() -> u32 {
    return WIDTH_BLOCKS * INPUT_BLOCKS;
}

fn layer_3_at() -> u32 {
    return layer_2_at() + WIDTH_BLOCKS * WIDTH_BLOCKS;
}

fn weight_blocks() -> u32 {
    return layer_3_at() + 2u * WIDTH_BLOCKS + 1u;
}

// sum + weights * x.
fn multiply_add(sum: Tile, w: Tile, x: Tile) -> Tile {
    return Tile(
        sum[0] + w[0] * x[0].x + w[1] * x[0].y + w[2] * x[0].z + w[3] * x[0].w,
        sum[1] + w[0] * x[1].x + w[1] * x[1].y + w[2] * x[1].z + w[3] * x[1].w,
        sum[2] + w[0] * x[2].x + w[1] * x[2].y + w[2] * x[2].z + w[3] * x[2].w,
        sum[3] + w[0] * x[3].x + w[1] * x[3].y + w[2] * x[3].z + w[3] * x[3].w,
    );
}

fn rectified(x: Tile) -> Tile {
    let zero = vec4<f32>(0.0);
    return Tile(max(x[0], zero), max(x[1], zero), max(x[2], zero), max(x[3], zero));
}

// The same four biases for every sample.
fn for_all_samples(bias: vec4<f32>) -> Tile {
    return Tile(bias, bias, bias, bias);
}

// Fills the inputs of sample `s` that describe its unit viewing direction.
fn set_view(inputs: ptr<function, Inputs>, s: u32, direction: vec3<f32>) {
    // Octaves by the double angle: sin 2x = 2 sin x cos x, cos 2x = 1 - 2 sin^2 x.
    let sin_1 = sine(direction);
    let cos_1 = cosine(direction);
    let sin_2 = 2.0 * sin_1 * cos_1;
    let cos_2 = 1.0 - 2.0 * sin_1 * sin_1;
    let sin_4 = 2.0 * sin_2 * cos_2;
    let cos_4 = 1.0 - 2.0 * sin_2 * sin_2;
    let sin_8 = 2.0 * sin_4 * cos_4;
    let cos_8 = 1.0 - 2.0 * sin_4 * sin_4;
    (*inputs)[3][s] = vec4<f32>(direction, 1.0);
    (*inputs)[4][s] = vec4<f32>(sin_1.x, sin_2.x, sin_4.x, sin_8.x);
    (*inputs)[5][s] = vec4<f32>(sin_1.y, sin_2.y, sin_4.y, sin_8.y);
    (*inputs)[6][s] = vec4<f32>(sin_1.z, sin_2.z, sin_4.z, sin_8.z);
    (*inputs)[7][s] = vec4<f32>(cos_1.x, cos_2.x, cos_4.x, cos_8.x);
    (*inputs)[8][s] = vec4<f32>(cos_1.y, cos_2.y, cos_4.y, cos_8.y);
    (*inputs)[9][s] = vec4<f32>(cos_1.z, cos_2.z, cos_4.z, cos_8.z);
}

// Taylor's series, below 1e-8 from the sine in -1..1.
fn sine(x: vec3<f32>) -> vec3<f32> {
    let q = x * x;
    return x + x * q * (-1.0 / 6.0 + q * (1.0 / 120.0 + q * (-1.0 / 5040.0 + q * (1.0 / 362880.0 - q * (1.0 / 39916800.0)))));
}

// Taylor's series, below 1e-8 from the cosine in -1..1.
fn cosine(x: vec3<f32>) -> vec3<f32> {
    let q = x * x;
    return 1.0 + q * (-0.5 + q * (1.0 / 24.0 + q * (-1.0 / 720.0 + q * (1.0 / 40320.0 - q * (1.0 / 3628800.0)))));
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

// Four terms of a row of layer 2 from block `at` on.
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

// Colours in the columns' first three rows, from the sum of the last layer.
fn colors_of(sum: Tile) -> Tile {
    return Tile(color_of(sum[0]), color_of(sum[1]), color_of(sum[2]), color_of(sum[3]));
}

fn color_of(sum: vec4<f32>) -> vec4<f32> {
    return vec4<f32>(sigmoid(sum.x), sigmoid(sum.y), sigmoid(sum.z), 0.0);
}

// sRGB of four samples.
fn network_colors(x: ptr<function, Inputs>) -> Tile {
    var hidden: Hidden;
    for (var row = 0u; row < WIDTH_BLOCKS; row++) {
        hidden[row] = hidden_1(row, x);
    }
    var sum = for_all_samples(layer_3[2u * WIDTH_BLOCKS][0]);
    for (var row = 0u; row < WIDTH_BLOCKS; row++) {
        sum = multiply_add(sum, layer_3[row], hidden_2(row, &hidden));
    }
    return colors_of(sum);
}
