// Colours of coloured samples, with the activations that a backward pass needs; one thread a sample, as many times as it takes.

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
fn network_forward(
    @builtin(global_invocation_id) id: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
) {
    let count = counters[COLORED_COUNT];
    for (var slot = id.x; slot < count; slot += groups.x * WORKGROUP_SIZE) {
        forward(slot);
    }
}

fn forward(slot: u32) {
    var inputs: Inputs;
    for (var i = 0u; i < INPUT_BLOCKS; i++) {
        inputs[i] = slot_inputs[slot * INPUT_BLOCKS + i];
    }
    let first = slot * WIDTH_BLOCKS;
    var hidden: Hidden;
    for (var row = 0u; row < WIDTH_BLOCKS; row++) {
        let neurons = hidden_1(row, &inputs);
        hidden[row] = neurons;
        if KEEPS_HIDDEN {
            hidden_a[first + row] = neurons;
        }
    }
    var sum = layer_3[2u * WIDTH_BLOCKS][0];
    for (var row = 0u; row < WIDTH_BLOCKS; row++) {
        let neurons = hidden_2(row, &hidden);
        if KEEPS_HIDDEN {
            hidden_b[first + row] = neurons;
        }
        sum += layer_3[row] * neurons;
    }
    slot_colors[slot] = color_of(sum);
}
