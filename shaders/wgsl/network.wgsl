// The colour network rgb = sigmoid(W3 relu(W2 relu(W1 input + b1) + b2) + b3) of one sample, in quads of neurons.
//
// A weight block's column c belongs to input neuron c, its rows to four output neurons; blocks of a layer are stored one output
// row after the other. The bias of layer 1 is the weight of an input 1. Terms are written out one by one: drivers then keep
// activations in registers, which they do not in loops.

// Hidden width in quads: 4, 8, 16 or 32.
override WIDTH_BLOCKS: u32;

// 12 features, then direction and 1, then sine and cosine octaves of the direction.
const INPUT_BLOCKS: u32 = 10u;
const FEATURE_BLOCKS: u32 = 3u;
const MAX_WIDTH_BLOCKS: u32 = 32u;

alias Inputs = array<vec4<f32>, INPUT_BLOCKS>;
alias Hidden = array<vec4<f32>, MAX_WIDTH_BLOCKS>;

// Four neurons of the first hidden layer.
fn hidden_1(row: u32, x: ptr<function, Inputs>) -> vec4<f32> {
    let w = row * INPUT_BLOCKS;
    var sum = layer_1[w] * (*x)[0];
    sum += layer_1[w + 1u] * (*x)[1];
    sum += layer_1[w + 2u] * (*x)[2];
    sum += layer_1[w + 3u] * (*x)[3];
    sum += layer_1[w + 4u] * (*x)[4];
    sum += layer_1[w + 5u] * (*x)[5];
    sum += layer_1[w + 6u] * (*x)[6];
    sum += layer_1[w + 7u] * (*x)[7];
    sum += layer_1[w + 8u] * (*x)[8];
    sum += layer_1[w + 9u] * (*x)[9];
    return max(sum, vec4<f32>(0.0));
}

// Four terms of a row of layer 2 from quad `at` on.
fn four_of_row(w: u32, x: ptr<function, Hidden>, at: u32) -> vec4<f32> {
    var sum = layer_2[w + at] * (*x)[at];
    sum += layer_2[w + at + 1u] * (*x)[at + 1u];
    sum += layer_2[w + at + 2u] * (*x)[at + 2u];
    sum += layer_2[w + at + 3u] * (*x)[at + 3u];
    return sum;
}

// Four neurons of the second hidden layer.
fn hidden_2(row: u32, x: ptr<function, Hidden>) -> vec4<f32> {
    let w = row * WIDTH_BLOCKS;
    var sum = layer_3[WIDTH_BLOCKS + row][0] + four_of_row(w, x, 0u);
    if WIDTH_BLOCKS >= 8u {
        sum += four_of_row(w, x, 4u);
    }
    if WIDTH_BLOCKS >= 16u {
        sum += four_of_row(w, x, 8u);
        sum += four_of_row(w, x, 12u);
    }
    if WIDTH_BLOCKS >= 32u {
        sum += four_of_row(w, x, 16u);
        sum += four_of_row(w, x, 20u);
        sum += four_of_row(w, x, 24u);
        sum += four_of_row(w, x, 28u);
    }
    return max(sum, vec4<f32>(0.0));
}

// sRGB from the sum of the last layer; the fourth component is 0.
fn color_of(sum: vec4<f32>) -> vec4<f32> {
    return vec4<f32>(sigmoid(sum.x), sigmoid(sum.y), sigmoid(sum.z), 0.0);
}

// sRGB of one sample.
fn network_color(x: ptr<function, Inputs>) -> vec4<f32> {
    var hidden: Hidden;
    for (var row = 0u; row < WIDTH_BLOCKS; row++) {
        hidden[row] = hidden_1(row, x);
    }
    var sum = layer_3[2u * WIDTH_BLOCKS][0];
    for (var row = 0u; row < WIDTH_BLOCKS; row++) {
        sum += layer_3[row] * hidden_2(row, &hidden);
    }
    return color_of(sum);
}
