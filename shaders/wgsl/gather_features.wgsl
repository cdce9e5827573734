// Interpolates the features of coloured samples; one thread a sample, as many times as it takes.

override WORKGROUP_SIZE: u32;

@group(0) @binding(0) var<uniform> params: TrainParams;
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
fn gather_features(
    @builtin(global_invocation_id) id: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
) {
    let count = counters[COLORED_COUNT];
    for (var slot = id.x; slot < count; slot += groups.x * WORKGROUP_SIZE) {
        let sample = slot_samples[slot];
        let features = features_at(rays[sample.ray].origin_m + rays[sample.ray].direction * sample.t);
        slot_features[3u * slot] = features.a;
        slot_features[3u * slot + 1u] = features.b;
        slot_features[3u * slot + 2u] = features.c;
    }
}
