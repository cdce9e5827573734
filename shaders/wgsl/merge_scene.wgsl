// Marches the background along one ray a thread and merges it with the samples of the objects on the ray: where intervals overlap,
// densities add and weights are shared in proportion to density, so that interpenetrating fields need no order.

override WORKGROUP_SIZE: u32;

@group(0) @binding(0) var<uniform> params: MarchParams;
@group(0) @binding(1) var<uniform> scene: SceneParams;
@group(0) @binding(2) var<storage, read> levels: array<Level>;
@group(0) @binding(3) var<storage, read> brick_index: array<u32>;
@group(0) @binding(4) var<storage, read> density: array<f32>;
@group(0) @binding(5) var<storage, read> block_index: array<u32>;
@group(0) @binding(6) var<storage, read> blocks: array<Block>;
@group(0) @binding(7) var<storage, read> rays: array<Ray>;
@group(0) @binding(8) var<storage, read> ray_pairs: array<RayPairs>;
@group(0) @binding(9) var<storage, read> pair_order: array<u32>;
@group(0) @binding(10) var<storage, read> pair_rays: array<Ray>;
@group(0) @binding(11) var<storage, read> object_boxes: array<ObjectBox>;
@group(0) @binding(12) var<storage, read> pair_samples: array<RaySample>;
@group(0) @binding(13) var<storage, read_write> pair_lists: array<SampleList>;
@group(0) @binding(14) var<storage, read_write> pair_weighted: array<Weighted>;
@group(0) @binding(15) var<storage, read_write> ray_lists: array<SampleList>;
@group(0) @binding(16) var<storage, read_write> ray_weighted: array<Weighted>;
@group(0) @binding(17) var<storage, read_write> hits: array<RayHit>;
@group(0) @binding(18) var<storage, read_write> worst: array<atomic<u32>>;

const FAR_AWAY: f32 = 3.0e38;

@compute @workgroup_size(WORKGROUP_SIZE)
fn merge_scene(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let ray_index = (group.y * params.groups_x + group.x) * WORKGROUP_SIZE + local;
    if ray_index >= params.ray_count {
        return;
    }
    let pairs = ray_pairs[ray_index];
    var through_object = false;
    for (var i = pairs.start; i < pairs.start + pairs.count; i++) {
        through_object = through_object || pair_lists[pair_order[i]].count > 0u;
    }
    if through_object {
        merge_ray(ray_index, pairs);
    } else {
        composite_ray(ray_index);
    }
    atomicMax(&worst[WORST_RAY_SAMPLES], ray_lists[ray_index].count);
}

// The background alone.
fn composite_ray(ray_index: u32) {
    let ray = rays[ray_index];
    var walk = begin_walk(ray);
    var light = Light(0.0, -1.0);
    var list: SampleList;
    loop {
        let sample = next_sample(ray, scene.stop_tau, &walk);
        if sample.dt <= 0.0 {
            break;
        }
        keep(&list, ray_index, Weighted(sample.t, absorb(&light, sample.sigma, start_of(sample), end_of(sample))));
    }
    ray_lists[ray_index] = list;
    finish(ray_index, light, light);
}

// The background with the objects of the ray's pairs.
fn merge_ray(ray_index: u32, pairs: RayPairs) {
    let ray = rays[ray_index];
    var walk = begin_walk(ray);
    var alone = Light(0.0, -1.0);
    var light = Light(0.0, -1.0);
    var list: SampleList;
    var behind = next_clear_sample(ray, pairs, &walk, &alone);
    var behind_weight = 0.0;
    var t = -FAR_AWAY;
    loop {
        // Total density just after t, and where it changes next.
        var sigma = 0.0;
        var next = FAR_AWAY;
        if behind.dt > 0.0 {
            let begun = start_of(behind) <= t;
            sigma = select(0.0, behind.sigma, begun);
            next = select(start_of(behind), end_of(behind), begun);
        }
        for (var i = pairs.start; i < pairs.start + pairs.count; i++) {
            let pair = pair_order[i];
            let cursor = pair_lists[pair].cursor;
            if cursor < pair_lists[pair].count {
                let sample = pair_samples[pair * scene.capacity + cursor];
                let begun = start_of(sample) <= t;
                sigma += select(0.0, sample.sigma, begun);
                next = min(next, select(start_of(sample), end_of(sample), begun));
            }
        }
        if next >= FAR_AWAY {
            break;
        }
        var share = 0.0;
        if sigma > 0.0 {
            share = absorb(&light, sigma, t, next) / sigma;
        }
        for (var i = pairs.start; i < pairs.start + pairs.count; i++) {
            advance_pair(pair_order[i], t, next, share);
        }
        if behind.dt > 0.0 {
            behind_weight += select(0.0, share * behind.sigma, start_of(behind) <= t);
        }
        while behind.dt > 0.0 && end_of(behind) <= next {
            keep(&list, ray_index, Weighted(behind.t, behind_weight));
            behind = next_clear_sample(ray, pairs, &walk, &alone);
            behind_weight = 0.0;
        }
        t = next;
    }
    ray_lists[ray_index] = list;
    finish(ray_index, light, alone);
}

// Gives a pair's sample its share of the interval t..next, and goes on to the sample that lies beyond.
fn advance_pair(pair: u32, t: f32, next: f32, share: f32) {
    var cursor = pair_lists[pair].cursor;
    let count = pair_lists[pair].count;
    if cursor >= count {
        return;
    }
    let base = pair * scene.capacity;
    let sample = pair_samples[base + cursor];
    if start_of(sample) <= t {
        let weight = share * sample.sigma;
        pair_weighted[base + cursor].weight += weight;
        pair_lists[pair].total_weight += weight;
    }
    while cursor < count && end_of(pair_samples[base + cursor]) <= next {
        cursor++;
    }
    pair_lists[pair].cursor = cursor;
}

// The background's next sample outside of the cuboids of the objects that the ray meets, except for the ground they stand on. `alone` sees every sample.
fn next_clear_sample(ray: Ray, pairs: RayPairs, walk: ptr<function, Walk>, alone: ptr<function, Light>) -> RaySample {
    loop {
        let sample = next_sample(ray, scene.stop_tau_through_object, walk);
        if sample.dt <= 0.0 {
            return sample;
        }
        absorb(alone, sample.sigma, start_of(sample), end_of(sample));
        if !is_haze(pairs, sample.t) {
            return sample;
        }
    }
    return RaySample();
}

fn is_haze(pairs: RayPairs, t: f32) -> bool {
    for (var i = pairs.start; i < pairs.start + pairs.count; i++) {
        let pair = pair_order[i];
        let cuboid = object_boxes[pair_lists[pair].object];
        let p = pair_rays[pair].origin_m + pair_rays[pair].direction * t;
        if pair_lists[pair].count > 0u && all(abs(p) <= cuboid.half_m) && p.z > cuboid.floor_m {
            return true;
        }
    }
    return false;
}

// Adds a sample to the ray's own list, which holds those with a colour.
fn keep(list: ptr<function, SampleList>, ray_index: u32, sample: Weighted) {
    (*list).total_weight += sample.weight;
    if sample.weight >= scene.min_weight {
        if (*list).count < scene.ray_capacity {
            ray_weighted[ray_index * scene.ray_capacity + (*list).count] = sample;
        }
        (*list).count++;
    }
}

fn finish(ray_index: u32, light: Light, alone: Light) {
    hits[ray_index].transmittance = exponential(-light.tau);
    hits[ray_index].half_t = light.half_t;
    hits[ray_index].background_half_t = alone.half_t;
}
