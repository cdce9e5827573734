// The colour network's inputs of coloured samples of a dense grid: interpolated features and the viewing direction; one thread a sample,
// as many times as it takes.

override WORKGROUP_SIZE: u32;

@group(0) @binding(0) var<uniform> params: GridParams;
@group(0) @binding(1) var<storage, read> features_a: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> features_b: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> features_c: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read> rays: array<PixelRay>;
@group(0) @binding(5) var<storage, read> samples: array<GridSample>;
@group(0) @binding(6) var<storage, read> slots: array<GridSlot>;
@group(0) @binding(7) var<storage, read> counters: array<u32>;
// Ten quads a slot.
@group(0) @binding(8) var<storage, read_write> slot_inputs: array<vec4<f32>>;

@compute @workgroup_size(WORKGROUP_SIZE)
fn grid_inputs(
    @builtin(global_invocation_id) id: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
) {
    let count = counters[COLORED_COUNT];
    for (var slot = id.x; slot < count; slot += groups.x * WORKGROUP_SIZE) {
        gather(slot);
    }
}

fn gather(slot: u32) {
    let cell = cell_at(samples[slots[slot].sample].q);
    var a = vec4<f32>(0.0);
    var b = vec4<f32>(0.0);
    var c = vec4<f32>(0.0);
    for (var corner = 0u; corner < 8u; corner++) {
        let node = corner_node(cell, corner);
        let weight = corner_weight(cell, corner);
        a += weight * features_a[node];
        b += weight * features_b[node];
        c += weight * features_c[node];
    }
    let first = slot * INPUT_QUADS;
    slot_inputs[first] = a;
    slot_inputs[first + 1u] = b;
    slot_inputs[first + 2u] = c;
    var view = view_inputs(rays[slots[slot].ray].direction);
    for (var quad = 0u; quad < VIEW_QUADS; quad++) {
        slot_inputs[first + 3u + quad] = view[quad];
    }
}
