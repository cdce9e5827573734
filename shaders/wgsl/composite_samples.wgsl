// Weights of the samples that were marched, and a slot in the colour batch for those that matter to a colour ray; one thread a ray.

override WORKGROUP_SIZE: u32;

@group(0) @binding(0) var<uniform> params: TrainParams;
@group(0) @binding(1) var<storage, read> summaries: array<RaySummary>;
@group(0) @binding(2) var<storage, read> samples: array<RaySample>;
@group(0) @binding(3) var<storage, read> targets: array<RayTarget>;
@group(0) @binding(4) var<storage, read_write> weights: array<f32>;
@group(0) @binding(5) var<storage, read_write> slots: array<u32>;
@group(0) @binding(6) var<storage, read_write> slot_samples: array<SlotSample>;
@group(0) @binding(7) var<storage, read_write> first_points: array<u32>;
@group(0) @binding(8) var<storage, read_write> counters: array<atomic<u32>>;

@compute @workgroup_size(WORKGROUP_SIZE)
fn composite_samples(@builtin(global_invocation_id) id: vec3<u32>) {
    let ray = id.x;
    if ray >= params.ray_count {
        return;
    }
    let first = ray * params.sample_capacity;
    let count = min(summaries[ray].sample_count, params.sample_capacity);
    // Nothing weighs more than 1, so nothing is shown on a ray without colour.
    let least = select(1.0, params.min_weight, targets[ray].color_weight > 0.0);
    var transmittance = 1.0;
    var shown = 0u;
    for (var i = first; i < first + count; i++) {
        let weight = -exponential_less_one(-(samples[i].sigma * samples[i].dt)) * transmittance;
        transmittance -= weight;
        weights[i] = weight;
        shown += u32(weight > least);
    }
    first_points[ray] = atomicAdd(&counters[POINT_COUNT], count);
    var slot = atomicAdd(&counters[COLORED_COUNT], shown);
    atomicAdd(&counters[STEP_POINT_COUNT], count);
    atomicAdd(&counters[STEP_COLORED_COUNT], shown);
    for (var i = first; i < first + count; i++) {
        if weights[i] > least {
            slots[i] = slot;
            slot_samples[slot] = SlotSample(ray, samples[i].t);
            slot++;
        } else {
            slots[i] = NO_SLOT;
        }
    }
}
