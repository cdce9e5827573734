// Sums over samples of output gradient times input, for tiles of a layer's weights.

// Quads of inputs in a row of a tile.
const TILE_QUADS: u32 = 4u;

// Sums of four outputs' weights from 16 inputs, and of their biases.
struct TileRow {
    blocks: array<mat4x4<f32>, TILE_QUADS>,
    bias: vec4<f32>,
}

// Quads past the last repeat it; what they sum is not stored.
fn input_quad(slot: u32, quad: u32) -> vec4<f32> {
    return layer_inputs[slot * layer.input_quads + min(quad, layer.input_quads - 1u)];
}

fn gradient_quad(slot: u32, quad: u32) -> vec4<f32> {
    return output_gradients[slot * layer.output_quads + min(quad, layer.output_quads - 1u)];
}

fn add_sample(row: ptr<function, TileRow>, gradient: vec4<f32>, x: array<vec4<f32>, TILE_QUADS>) {
    (*row).bias += gradient;
    (*row).blocks[0] = add_outer((*row).blocks[0], gradient, x[0]);
    (*row).blocks[1] = add_outer((*row).blocks[1], gradient, x[1]);
    (*row).blocks[2] = add_outer((*row).blocks[2], gradient, x[2]);
    (*row).blocks[3] = add_outer((*row).blocks[3], gradient, x[3]);
}

fn add_outer(sum: mat4x4<f32>, gradient: vec4<f32>, x: vec4<f32>) -> mat4x4<f32> {
    return mat4x4<f32>(
        sum[0] + gradient * x.x,
        sum[1] + gradient * x.y,
        sum[2] + gradient * x.z,
        sum[3] + gradient * x.w,
    );
}

fn store_row(first: u32, input: u32, output: u32, row: TileRow) {
    if output >= layer.output_quads || input >= layer.input_quads {
        return;
    }
    var blocks = row.blocks;
    for (var i = 0u; i < min(TILE_QUADS, layer.input_quads - input); i++) {
        let at = first + layer.first_block + output * layer.input_quads + input + i;
        weight_gradients[at] = weight_gradients[at] + blocks[i];
    }
    // Biases are first columns.
    if input == 0u && layer.first_bias > 0u {
        weight_gradients[first + layer.first_bias + output][0] += row.bias;
    }
}
