// layer_gradients with tiles of 32 x 32 weights, for adapters on which a load costs as much as tens of multiplications: software.

override WORKGROUP_SIZE: u32;

// Quads along one edge of a tile.
const WIDE_QUADS: u32 = 8u;

@group(0) @binding(0) var<uniform> layer: LayerParams;
@group(0) @binding(1) var<storage, read> counters: array<u32>;
@group(0) @binding(2) var<storage, read> layer_inputs: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> output_gradients: array<vec4<f32>>;
// Every share's sums, one share after the other.
@group(0) @binding(4) var<storage, read_write> weight_gradients: array<mat4x4<f32>>;

struct WideRow {
    left: TileRow,
    right: TileRow,
}

@compute @workgroup_size(WORKGROUP_SIZE)
fn layer_gradients_wide(@builtin(global_invocation_id) id: vec3<u32>) {
    let tiles = vec2<u32>(layer.input_quads + WIDE_QUADS - 1u, layer.output_quads + WIDE_QUADS - 1u) / WIDE_QUADS;
    let share = id.x / (tiles.x * tiles.y);
    if share >= layer.shares {
        return;
    }
    let tile = id.x % (tiles.x * tiles.y);
    let input = WIDE_QUADS * (tile % tiles.x);
    let output = WIDE_QUADS * (tile / tiles.x);
    var row_0: WideRow;
    var row_1: WideRow;
    var row_2: WideRow;
    var row_3: WideRow;
    var row_4: WideRow;
    var row_5: WideRow;
    var row_6: WideRow;
    var row_7: WideRow;
    for (var slot = share; slot < counters[COLORED_COUNT]; slot += layer.shares) {
        let left = four_inputs(slot, input);
        let right = four_inputs(slot, input + TILE_QUADS);
        add_wide(&row_0, gradient_quad(slot, output), left, right);
        add_wide(&row_1, gradient_quad(slot, output + 1u), left, right);
        add_wide(&row_2, gradient_quad(slot, output + 2u), left, right);
        add_wide(&row_3, gradient_quad(slot, output + 3u), left, right);
        add_wide(&row_4, gradient_quad(slot, output + 4u), left, right);
        add_wide(&row_5, gradient_quad(slot, output + 5u), left, right);
        add_wide(&row_6, gradient_quad(slot, output + 6u), left, right);
        add_wide(&row_7, gradient_quad(slot, output + 7u), left, right);
    }
    let first = share * layer.weight_blocks;
    store_wide(first, input, output, row_0);
    store_wide(first, input, output + 1u, row_1);
    store_wide(first, input, output + 2u, row_2);
    store_wide(first, input, output + 3u, row_3);
    store_wide(first, input, output + 4u, row_4);
    store_wide(first, input, output + 5u, row_5);
    store_wide(first, input, output + 6u, row_6);
    store_wide(first, input, output + 7u, row_7);
}

fn four_inputs(slot: u32, quad: u32) -> array<vec4<f32>, TILE_QUADS> {
    return array<vec4<f32>, TILE_QUADS>(
        input_quad(slot, quad),
        input_quad(slot, quad + 1u),
        input_quad(slot, quad + 2u),
        input_quad(slot, quad + 3u),
    );
}

fn add_wide(
    row: ptr<function, WideRow>,
    gradient: vec4<f32>,
    left: array<vec4<f32>, TILE_QUADS>,
    right: array<vec4<f32>, TILE_QUADS>,
) {
    var sums = *row;
    add_sample(&sums.left, gradient, left);
    add_sample(&sums.right, gradient, right);
    *row = sums;
}

fn store_wide(first: u32, input: u32, output: u32, row: WideRow) {
    store_row(first, input, output, row.left);
    store_row(first, input + TILE_QUADS, output, row.right);
}
