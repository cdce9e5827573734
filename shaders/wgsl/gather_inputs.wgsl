// The colour network's inputs of coloured samples: interpolated features, from one part of the nodes after the other, and with the first
// part the viewing direction; one thread a sample, as many times as it takes.

override WORKGROUP_SIZE: u32;

@group(0) @binding(0) var<uniform> part: PartParams;
@group(0) @binding(1) var<storage, read> levels: array<Level>;
@group(0) @binding(2) var<storage, read> brick_index: array<u32>;
@group(0) @binding(3) var<storage, read> features_a: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read> features_b: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read> features_c: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read> rays: array<Ray>;
@group(0) @binding(7) var<storage, read> slot_samples: array<SlotSample>;
@group(0) @binding(8) var<storage, read> counters: array<u32>;
// Ten quads a slot.
@group(0) @binding(9) var<storage, read_write> slot_inputs: array<vec4<f32>>;

@compute @workgroup_size(WORKGROUP_SIZE)
fn gather_inputs(
    @builtin(global_invocation_id) id: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
) {
    let count = counters[COLORED_COUNT];
    for (var slot = id.x; slot < count; slot += groups.x * WORKGROUP_SIZE) {
        gather(slot);
    }
}

fn gather(slot: u32) {
    let sample = slot_samples[slot];
    let direction = rays[sample.ray].direction;
    let first = slot * INPUT_QUADS;
    var features: Features;
    if part.first_node > 0u {
        features = Features(slot_inputs[first], slot_inputs[first + 1u], slot_inputs[first + 2u]);
    } else {
        var view = view_inputs(direction);
        for (var quad = 0u; quad < VIEW_QUADS; quad++) {
            slot_inputs[first + 3u + quad] = view[quad];
        }
    }
    features = add_part(features, rays[sample.ray].origin_m + direction * sample.t);
    slot_inputs[first] = features.a;
    slot_inputs[first + 1u] = features.b;
    slot_inputs[first + 2u] = features.c;
}
