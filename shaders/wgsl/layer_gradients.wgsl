// Gradient of one layer's weights: the sum over samples of output gradient times input. One thread a tile of 16 inputs x 16
// outputs and a share of the samples.

override WORKGROUP_SIZE: u32;

@group(0) @binding(0) var<uniform> layer: LayerParams;
@group(0) @binding(1) var<storage, read> counters: array<u32>;
@group(0) @binding(2) var<storage, read> layer_inputs: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> output_gradients: array<vec4<f32>>;
// Every share's sums, one share after the other.
@group(0) @binding(4) var<storage, read_write> weight_gradients: array<mat4x4<f32>>;

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
