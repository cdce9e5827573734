// network_forward with four samples a thread.

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
fn network_forward_four(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) thread: u32,
    @builtin(subgroup_invocation_id) own_lane: u32,
) {
    lane = own_lane % LANES;
    let count = counters[COLORED_COUNT];
    let step = 4u * WORKGROUP_SIZE;
    for (var first = step * group.x; first < count; first += step * groups.x) {
        forward(first + 4u * thread);
    }
}

// Slots past the last hold leavings; what comes of those is read by nobody.
fn forward(slot: u32) {
    var inputs: Inputs;
    for (var i = 0u; i < INPUT_BLOCKS; i++) {
        let at = slot * INPUT_BLOCKS + i;
        inputs[i] = Tile(
            slot_inputs[at],
            slot_inputs[at + INPUT_BLOCKS],
            slot_inputs[at + 2u * INPUT_BLOCKS],
            slot_inputs[at + 3u * INPUT_BLOCKS],
        );
    }
    let first = slot * WIDTH_BLOCKS;
    var hidden: Hidden;
    for (var row = 0u; row < WIDTH_BLOCKS; row++) {
        let neurons = hidden_1(row, &inputs);
        hidden[row] = neurons;
        if KEEPS_HIDDEN {
            hidden_a[first + row] = neurons[0];
            hidden_a[first + WIDTH_BLOCKS + row] = neurons[1];
            hidden_a[first + 2u * WIDTH_BLOCKS + row] = neurons[2];
            hidden_a[first + 3u * WIDTH_BLOCKS + row] = neurons[3];
        }
    }
    var sum = for_all_samples(layer_3[2u * WIDTH_BLOCKS][0]);
    for (var row = 0u; row < WIDTH_BLOCKS; row++) {
        let neurons = hidden_2(row, &hidden);
        sum = multiply_add_block(sum, block_3(row), neurons);
        if KEEPS_HIDDEN {
            hidden_b[first + row] = neurons[0];
            hidden_b[first + WIDTH_BLOCKS + row] = neurons[1];
            hidden_b[first + 2u * WIDTH_BLOCKS + row] = neurons[2];
            hidden_b[first + 3u * WIDTH_BLOCKS + row] = neurons[3];
        }
    }
    slot_colors[slot] = color_of(sum[0]);
    slot_colors[slot + 1u] = color_of(sum[1]);
    slot_colors[slot + 2u] = color_of(sum[2]);
    slot_colors[slot + 3u] = color_of(sum[3]);
}
