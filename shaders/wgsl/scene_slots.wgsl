// Gives every sample that weighs enough a slot in the colour batch; one thread a list.

override WORKGROUP_SIZE: u32;

@group(0) @binding(0) var<uniform> scene: SceneParams;
@group(0) @binding(1) var<storage, read> lists: array<SampleList>;
@group(0) @binding(2) var<storage, read> weighted: array<Weighted>;
@group(0) @binding(3) var<storage, read_write> slot_samples: array<SlotSample>;
@group(0) @binding(4) var<storage, read_write> slot_weights: array<f32>;
@group(0) @binding(5) var<storage, read_write> slot_ranges: array<SlotRange>;
@group(0) @binding(6) var<storage, read_write> counters: array<atomic<u32>>;
@group(0) @binding(7) var<storage, read_write> worst: array<atomic<u32>>;

@compute @workgroup_size(WORKGROUP_SIZE)
fn scene_slots(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let number = (group.y * scene.groups_x + group.x) * WORKGROUP_SIZE + local;
    if number >= scene.count {
        return;
    }
    let list = scene.first + number;
    let base = list * scene.capacity;
    let end = base + min(lists[list].count, scene.capacity);
    var kept = 0u;
    var kept_weight = 0.0;
    for (var i = base; i < end; i++) {
        let weight = weighted[i].weight;
        if weight >= scene.min_weight {
            kept++;
            kept_weight += weight;
        }
    }
    if kept == 0u {
        slot_ranges[list] = SlotRange(0u, 0u);
        return;
    }
    // The rest of the list is scaled up for what has no colour of its own.
    let scale = lists[list].total_weight / kept_weight;
    var slot = atomicAdd(&counters[COLORED_COUNT], kept);
    atomicMax(&worst[WORST_SLOTS], slot + kept);
    if slot + kept > scene.slot_capacity {
        slot_ranges[list] = SlotRange(0u, 0u);
        return;
    }
    slot_ranges[list] = SlotRange(slot, kept);
    for (var i = base; i < end; i++) {
        if weighted[i].weight >= scene.min_weight {
            slot_samples[slot] = SlotSample(list, weighted[i].t);
            slot_weights[slot] = weighted[i].weight * scale;
            slot++;
        }
    }
}
