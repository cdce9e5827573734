// Interpolates the features of listed samples from one part of the nodes and adds them to what the parts before contributed: features
// that no binding holds as a whole are gathered part by part. One thread a sample, as many times as it takes.

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
@group(0) @binding(9) var<storage, read_write> slot_features: array<vec4<f32>>;

@compute @workgroup_size(WORKGROUP_SIZE)
fn scene_features(
    @builtin(global_invocation_id) id: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
) {
    let count = counters[COLORED_COUNT];
    for (var slot = id.x; slot < count; slot += groups.x * WORKGROUP_SIZE) {
        let sample = slot_samples[slot];
        let point = rays[sample.ray].origin_m + rays[sample.ray].direction * sample.t;
        let first = 3u * slot;
        var features: Features;
        if part.first_node > 0u {
            features = Features(slot_features[first], slot_features[first + 1u], slot_features[first + 2u]);
        }
        features = add_part(features, point);
        slot_features[first] = features.a;
        slot_features[first + 1u] = features.b;
        slot_features[first + 2u] = features.c;
    }
}
