// Drops what an object's field holds below its wheels, and sums up what the object would hide alone; one thread a pair.

override WORKGROUP_SIZE: u32;

@group(0) @binding(0) var<uniform> scene: SceneParams;
@group(0) @binding(1) var<storage, read> rays: array<Ray>;
@group(0) @binding(2) var<storage, read> summaries: array<RaySummary>;
@group(0) @binding(3) var<storage, read_write> samples: array<RaySample>;
@group(0) @binding(4) var<storage, read_write> lists: array<SampleList>;
@group(0) @binding(5) var<storage, read_write> weighted: array<Weighted>;
@group(0) @binding(6) var<storage, read_write> worst: array<atomic<u32>>;

@compute @workgroup_size(WORKGROUP_SIZE)
fn object_samples(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let number = (group.y * scene.groups_x + group.x) * WORKGROUP_SIZE + local;
    if number >= scene.count {
        return;
    }
    let list = scene.first + number;
    atomicMax(&worst[WORST_PAIR_SAMPLES], summaries[list].sample_count);
    let base = list * scene.capacity;
    let end = base + min(summaries[list].sample_count, scene.capacity);
    let from_z = rays[list].origin_m.z;
    let along_z = rays[list].direction.z;
    var kept = 0u;
    var tau = 0.0;
    for (var i = base; i < end; i++) {
        let sample = samples[i];
        if from_z + sample.t * along_z >= scene.lowest_m {
            samples[base + kept] = sample;
            weighted[base + kept] = Weighted(sample.t, 0.0);
            kept++;
            tau += sample.sigma * sample.dt;
        }
    }
    lists[list] = SampleList(kept, 0u, scene.object, 0.0, -exponential_less_one(-tau));
}
