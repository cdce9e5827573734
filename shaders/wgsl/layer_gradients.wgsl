// Gradient of one layer's weights: the sum over samples of output gradient times input. One thread a tile of 16 inputs x 16
// outputs and a share of the samples.

override WORKGROUP_SIZE: u32;

// Quads along one edge of a tile.
const TILE_QUADS: u32 = 4u;

@group(0) @binding(0) var<uniform> layer: LayerParams;
@group(0) @binding(1) var<storage, read> counters: array<u32>;
@group(0) @binding(2) var<storage, read> layer_inputs: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> output_gradients: array<vec4<f32>>;
// Every share's sums, one share after the other.
@group(0) @binding(4) var<storage, read_write> weight_gradients: array<mat4x4<f32>>;

// Sums of four outputs' weights from 16 inputs, and of their biases.
struct TileRow {
    blocks: array<mat4x4<f32>, TILE_QUADS>,
    bias: vec4<f32>,
}

@compute @workgroup_size(WORKGROUP_SIZE)
fn layer_gradients(@builtin(global_invocation_id) id: vec3<u32>) {
    let tiles = vec2<u32>(layer.input_quads + TILE_QUADS - 1u, layer.output_quads + TILE_QUADS - 1u) / TILE_QUADS;
    let share = id.x / (tiles.x * tiles.y);
    if share >= layer.shares {
        return;
    }
    let tile = id.x % (tiles.x * tiles.y);
    let input = TILE_QUADS * (tile % tiles.x);
    let output = TILE_QUADS * (tile / tiles.x);
    var row_0: TileRow;
    var row_1: TileRow;
    var row_2: TileRow;
    var row_3: TileRow;
    for (var slot = share; slot < counters[COLORED_COUNT]; slot += layer.shares) {
        let x = array<vec4<f32>, TILE_QUADS>(
            input_quad(slot, input),
            input_quad(slot, input + 1u),
            input_quad(slot, input + 2u),
            input_quad(slot, input + 3u),
        );
        add_sample(&row_0, gradient_quad(slot, output), x);
        add_sample(&row_1, gradient_quad(slot, output + 1u), x);
        add_sample(&row_2, gradient_quad(slot, output + 2u), x);
        add_sample(&row_3, gradient_quad(slot, output + 3u), x);
    }
    let first = share * layer.weight_blocks;
    store_row(first, input, output, row_0);
    store_row(first, input, output + 1u, row_1);
    store_row(first, input, output + 2u, row_2);
    store_row(first, input, output + 3u, row_3);
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
    if output >= layer.output_quads {
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
