// Colours of listed samples, of which nothing but the colour is kept; one thread a sample, as many times as it takes.

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
fn scene_network(
    @builtin(global_invocation_id) id: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
) {
    let count = counters[COLORED_COUNT];
    for (var slot = id.x; slot < count; slot += groups.x * WORKGROUP_SIZE) {
        slot_colors[slot] = color_of_slot(slot);
    }
}

fn color_of_slot(slot: u32) -> vec4<f32> {
    let view = view_inputs(rays[slot_samples[slot].ray].direction);
    var inputs = Inputs(
        slot_features[3u * slot],
        slot_features[3u * slot + 1u],
        slot_features[3u * slot + 2u],
        view[0],
        view[1],
        view[2],
        view[3],
        view[4],
        view[5],
        view[6],
    );
    return network_color(&inputs);
}
