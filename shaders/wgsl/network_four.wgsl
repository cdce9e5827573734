// The colour network of four samples a thread, whose weights eight threads of a subgroup read together: for software adapters, on which
// reading a weight costs ten times what using it does.
//
// A Tile's column is a sample, its rows four neurons. Of eight columns of weights each thread reads one and takes the others from its
// neighbours, so all threads run alike. Weights and terms are as in network.wgsl.

// Hidden width in quads: 4, 8, 16 or 32.
override WIDTH_BLOCKS: u32;

const INPUT_BLOCKS: u32 = 10u;
const FEATURE_BLOCKS: u32 = 3u;
const MAX_WIDTH_BLOCKS: u32 = 32u;
const LANES: u32 = 8u;

alias Tile = mat4x4<f32>;
alias Inputs = array<Tile, INPUT_BLOCKS>;
alias Hidden = array<Tile, MAX_WIDTH_BLOCKS>;
alias Columns = array<vec4<f32>, LANES>;

// The thread's number among eight of its subgroup.
var<private> lane: u32;

// What each of the eight threads has read.
fn of_all_lanes(own: vec4<f32>) -> Columns {
    return Columns(
        subgroupBroadcast(own, 0u),
        subgroupBroadcast(own, 1u),
        subgroupBroadcast(own, 2u),
        subgroupBroadcast(own, 3u),
        subgroupBroadcast(own, 4u),
        subgroupBroadcast(own, 5u),
        subgroupBroadcast(own, 6u),
        subgroupBroadcast(own, 7u),
    );
}

// The columns of a block of layer 1 and of the one after it.
fn columns_1(block: u32) -> Columns {
    return of_all_lanes(layer_1[block + lane / 4u][lane % 4u]);
}

// The columns of a block of layer 2 and of the one `stride` blocks after it.
fn columns_2(block: u32, stride: u32) -> Columns {
    return of_all_lanes(layer_2[block + stride * (lane / 4u)][lane % 4u]);
}

// The columns of a block of layer 3.
fn block_3(block: u32) -> Tile {
    let own = layer_3[block][lane % 4u];
    return Tile(
        subgroupBroadcast(own, 0u),
        subgroupBroadcast(own, 1u),
        subgroupBroadcast(own, 2u),
        subgroupBroadcast(own, 3u),
    );
}

// sum + weights * x, with the weights of eight inputs.
fn multiply_add(sum: Tile, w: Columns, low: Tile, high: Tile) -> Tile {
    return Tile(
        eight_terms(sum[0], w, low[0], high[0]),
        eight_terms(sum[1], w, low[1], high[1]),
        eight_terms(sum[2], w, low[2], high[2]),
        eight_terms(sum[3], w, low[3], high[3]),
    );
}

fn eight_terms(sum: vec4<f32>, w: Columns, low: vec4<f32>, high: vec4<f32>) -> vec4<f32> {
    let first = sum + w[0] * low.x + w[1] * low.y + w[2] * low.z + w[3] * low.w;
    return first + w[4] * high.x + w[5] * high.y + w[6] * high.z + w[7] * high.w;
}

// sum + weights * x.
fn multiply_add_block(sum: Tile, w: Tile, x: Tile) -> Tile {
    return Tile(
        sum[0] + w[0] * x[0].x + w[1] * x[0].y + w[2] * x[0].z + w[3] * x[0].w,
        sum[1] + w[0] * x[1].x + w[1] * x[1].y + w[2] * x[1].z + w[3] * x[1].w,
        sum[2] + w[0] * x[2].x + w[1] * x[2].y + w[2] * x[2].z + w[3] * x[2].w,
        sum[3] + w[0] * x[3].x + w[1] * x[3].y + w[2] * x[3].z + w[3] * x[3].w,
    );
}

// sum + transposed weights * gradient, with the weights of the first or the last four columns.
fn multiply_back(sum: Tile, w: Tile, gradient: Tile) -> Tile {
    return Tile(
        sum[0] + gradient[0] * w,
        sum[1] + gradient[1] * w,
        sum[2] + gradient[2] * w,
        sum[3] + gradient[3] * w,
    );
}

fn low_columns(w: Columns) -> Tile {
    return Tile(w[0], w[1], w[2], w[3]);
}

fn high_columns(w: Columns) -> Tile {
    return Tile(w[4], w[5], w[6], w[7]);
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
    var sum = multiply_add(Tile(), columns_1(w), (*x)[0], (*x)[1]);
    sum = multiply_add(sum, columns_1(w + 2u), (*x)[2], (*x)[3]);
    sum = multiply_add(sum, columns_1(w + 4u), (*x)[4], (*x)[5]);
    sum = multiply_add(sum, columns_1(w + 6u), (*x)[6], (*x)[7]);
    return rectified(multiply_add(sum, columns_1(w + 8u), (*x)[8], (*x)[9]));
}

// Four blocks' terms of a row of layer 2 from quad `at` on.
fn four_of_row(sum: Tile, w: u32, x: ptr<function, Hidden>, at: u32) -> Tile {
    let next = multiply_add(sum, columns_2(w + at, 1u), (*x)[at], (*x)[at + 1u]);
    return multiply_add(next, columns_2(w + at + 2u, 1u), (*x)[at + 2u], (*x)[at + 3u]);
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
    let next = two_back(sum, columns_2(at * WIDTH_BLOCKS + row, WIDTH_BLOCKS), by_b, at);
    return two_back(next, columns_2((at + 2u) * WIDTH_BLOCKS + row, WIDTH_BLOCKS), by_b, at + 2u);
}

fn two_back(sum: Tile, w: Columns, by_b: ptr<function, Hidden>, at: u32) -> Tile {
    let next = multiply_back(sum, low_columns(w), (*by_b)[at]);
    return multiply_back(next, high_columns(w), (*by_b)[at + 1u]);
}

// sRGB from the sums of the last layer; the fourth component is 0.
fn color_of(sum: vec4<f32>) -> vec4<f32> {
    return vec4<f32>(sigmoid(sum.x), sigmoid(sum.y), sigmoid(sum.z), 0.0);
}
