// network_forward with sixteen samples a thread.

override WORKGROUP_SIZE: u32;
// Whether activations are stored for a backward pass.
override KEEPS_HIDDEN: bool;

@group(0) @binding(0) var<uniform> layer_1: array<mat4x4<f32>, 320>;
@group(0) @binding(1) var<uniform> layer_2: array<mat4x4<f32>, 1024>;
@group(0) @binding(2) var<uniform> layer_3: array<mat4x4<f32>, 65>;
@group(0) @binding(3) var<storage, read> counters: array<u32>;
@group(0) @binding(4) var<storage, read> slot_inputs: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read_write> hidden_a: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read_write> hidden_b: array<vec4<f32>>;
@group(0) @binding(7) var<storage, read_write> slot_colors: array<vec4<f32>>;

@compute @workgroup_size(WORKGROUP_SIZE)
fn network_forward_many(
    @builtin(global_invocation_id) id: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
) {
    let count = counters[COLORED_COUNT];
    for (var slot = MANY * id.x; slot < count; slot += MANY * groups.x * WORKGROUP_SIZE) {
        forward(slot);
    }
}

// Slots past the last hold leavings; what comes of those is read by nobody.
fn forward(slot: u32) {
    var inputs: Inputs;
    for (var i = 0u; i < INPUT_BLOCKS; i++) {
        inputs[i] = Tiles(
            input_tile(slot, i),
            input_tile(slot + TILE, i),
            input_tile(slot + 2u * TILE, i),
            input_tile(slot + 3u * TILE, i),
        );
    }
    var hidden: Hidden;
    for (var row = 0u; row < WIDTH_BLOCKS; row++) {
        let neurons = hidden_1(row, &inputs);
        hidden[row] = neurons;
        if KEEPS_HIDDEN {
            keep_a(slot, row, neurons.a);
            keep_a(slot + TILE, row, neurons.b);
            keep_a(slot + 2u * TILE, row, neurons.c);
            keep_a(slot + 3u * TILE, row, neurons.d);
        }
    }
    var sum = for_all_samples(layer_3[2u * WIDTH_BLOCKS][0]);
    for (var row = 0u; row < WIDTH_BLOCKS; row++) {
        let neurons = hidden_2(row, &hidden);
        sum = multiply_add(sum, layer_3[row], neurons);
        if KEEPS_HIDDEN {
            keep_b(slot, row, neurons.a);
            keep_b(slot + TILE, row, neurons.b);
            keep_b(slot + 2u * TILE, row, neurons.c);
            keep_b(slot + 3u * TILE, row, neurons.d);
        }
    }
    store_colors(slot, sum.a);
    store_colors(slot + TILE, sum.b);
    store_colors(slot + 2u * TILE, sum.c);
    store_colors(slot + 3u * TILE, sum.d);
}

fn input_tile(slot: u32, i: u32) -> Tile {
    let at = slot * INPUT_BLOCKS + i;
    return Tile(
        slot_inputs[at],
        slot_inputs[at + INPUT_BLOCKS],
        slot_inputs[at + 2u * INPUT_BLOCKS],
        slot_inputs[at + 3u * INPUT_BLOCKS],
    );
}

fn keep_a(slot: u32, row: u32, neurons: Tile) {
    let at = slot * WIDTH_BLOCKS + row;
    hidden_a[at] = neurons[0];
    hidden_a[at + WIDTH_BLOCKS] = neurons[1];
    hidden_a[at + 2u * WIDTH_BLOCKS] = neurons[2];
    hidden_a[at + 3u * WIDTH_BLOCKS] = neurons[3];
}

fn keep_b(slot: u32, row: u32, neurons: Tile) {
    let at = slot * WIDTH_BLOCKS + row;
    hidden_b[at] = neurons[0];
    hidden_b[at + WIDTH_BLOCKS] = neurons[1];
    hidden_b[at + 2u * WIDTH_BLOCKS] = neurons[2];
    hidden_b[at + 3u * WIDTH_BLOCKS] = neurons[3];
}

fn store_colors(slot: u32, sum: Tile) {
    slot_colors[slot] = color_of(sum[0]);
    slot_colors[slot + 1u] = color_of(sum[1]);
    slot_colors[slot + 2u] = color_of(sum[2]);
    slot_colors[slot + 3u] = color_of(sum[3]);
}
