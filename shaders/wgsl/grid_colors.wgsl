// Colours of coloured samples of a dense grid that stores colour itself; one thread a sample, as many times as it takes.

override WORKGROUP_SIZE: u32;

@group(0) @binding(0) var<uniform> params: GridParams;
// Before the logistic; fourth components are padding.
@group(0) @binding(1) var<storage, read> colors: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> samples: array<GridSample>;
@group(0) @binding(3) var<storage, read> slots: array<GridSlot>;
@group(0) @binding(4) var<storage, read> counters: array<u32>;
@group(0) @binding(5) var<storage, read_write> slot_colors: array<vec4<f32>>;

@compute @workgroup_size(WORKGROUP_SIZE)
fn grid_colors(
    @builtin(global_invocation_id) id: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
) {
    let count = counters[COLORED_COUNT];
    for (var slot = id.x; slot < count; slot += groups.x * WORKGROUP_SIZE) {
        let cell = cell_at(samples[slots[slot].sample].q);
        var sum = vec4<f32>(0.0);
        for (var corner = 0u; corner < 8u; corner++) {
            sum += corner_weight(cell, corner) * colors[corner_node(cell, corner)];
        }
        slot_colors[slot] = vec4<f32>(sigmoid(sum.x), sigmoid(sum.y), sigmoid(sum.z), 0.0);
    }
}
