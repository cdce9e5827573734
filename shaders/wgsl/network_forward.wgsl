// Colours of coloured samples; one thread four samples, as many times as it takes.

override WORKGROUP_SIZE: u32;

@group(0) @binding(0) var<uniform> layer_1: array<mat4x4<f32>, 320>;
@group(0) @binding(1) var<uniform> layer_2: array<mat4x4<f32>, 1024>;
@group(0) @binding(2) var<uniform> layer_3: array<mat4x4<f32>, 65>;
@group(0) @binding(3) var<storage, read> rays: array<Ray>;
@group(0) @binding(4) var<storage, read> slot_samples: array<SlotSample>;
@group(0) @binding(5) var<storage, read> slot_features: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read> counters: array<u32>;
@group(0) @binding(7) var<storage, read_write> slot_colors: array<vec4<f32>>;

@compute @workgroup_size(WORKGROUP_SIZE)
fn network_forward(
    @builtin(global_invocation_id) id: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
) {
    let count = counters[COLORED_COUNT];
    for (var slot = 4u * id.x; slot < count; slot += 4u * groups.x * WORKGROUP_SIZE) {
        var inputs: Inputs;
        inputs_of_slots(slot, count - 1u, &inputs);
        var colors = network_colors(&inputs);
        for (var s = 0u; s < min(4u, count - slot); s++) {
            slot_colors[slot + s] = colors[s];
        }
    }
}
