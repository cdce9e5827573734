// Sums the coloured samples of every list; one thread a list.

override WORKGROUP_SIZE: u32;

@group(0) @binding(0) var<uniform> scene: SceneParams;
@group(0) @binding(1) var<storage, read> slot_ranges: array<SlotRange>;
@group(0) @binding(2) var<storage, read> slot_weights: array<f32>;
@group(0) @binding(3) var<storage, read> slot_colors: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read_write> colors: array<vec4<f32>>;

@compute @workgroup_size(WORKGROUP_SIZE)
fn scene_colors(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let number = (group.y * scene.groups_x + group.x) * WORKGROUP_SIZE + local;
    if number >= scene.count {
        return;
    }
    let list = scene.first + number;
    let slots = slot_ranges[list];
    var sum = vec3<f32>(0.0);
    for (var slot = slots.first; slot < slots.first + slots.count; slot++) {
        let color = scene.tone_gain * slot_colors[slot].xyz + scene.tone_offset;
        sum += slot_weights[slot] * clamp(color, vec3<f32>(0.0), vec3<f32>(1.0));
    }
    colors[list] = vec4<f32>(sum, 0.0);
}
