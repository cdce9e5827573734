// Marches one ray a thread through occupied space and records every sample it decides to take.

override WORKGROUP_SIZE: u32;

struct MarchParams {
    // Lower corner of the box outside of which nothing is.
    low_m: vec3<f32>,
    // Length in metres that raw densities are activated for.
    base_voxel_m: f32,
    // Upper corner of the box.
    high_m: vec3<f32>,
    // Added to the raw density before the activation.
    act_shift: f32,
    occupancy_origin_m: vec3<f32>,
    // Edge of an occupancy cell, metres.
    cell_m: f32,
    // Occupancy blocks along x, y and z.
    blocks: vec3<u32>,
    level_count: u32,
    // Metres of step per metre of distance.
    step_growth: f32,
    // Densities below this (1/m) are dropped.
    sigma_min: f32,
    // Step past a cell's face, metres.
    nudge_m: f32,
    ray_count: u32,
    // Samples kept per ray; a ray that took more says so in sample_count.
    sample_capacity: u32,
    // Workgroups along x of the dispatch, which is folded into two dimensions.
    groups_x: u32,
}

@group(0) @binding(0) var<uniform> params: MarchParams;
@group(0) @binding(1) var<storage, read> levels: array<Level>;
@group(0) @binding(2) var<storage, read> brick_index: array<u32>;
@group(0) @binding(3) var<storage, read> density: array<f32>;
@group(0) @binding(4) var<storage, read> block_index: array<u32>;
@group(0) @binding(5) var<storage, read> blocks: array<Block>;
@group(0) @binding(6) var<storage, read> rays: array<Ray>;
@group(0) @binding(7) var<storage, read_write> summaries: array<RaySummary>;
@group(0) @binding(8) var<storage, read_write> samples: array<RaySample>;

@compute @workgroup_size(WORKGROUP_SIZE)
fn march_density(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let ray_index = (group.y * params.groups_x + group.x) * WORKGROUP_SIZE + local;
    if ray_index < params.ray_count {
        summaries[ray_index] = march(rays[ray_index], ray_index * params.sample_capacity);
    }
}

fn march(ray: Ray, first_sample: u32) -> RaySummary {
    var summary: RaySummary;
    let inverse = reciprocal(ray.direction);
    let a = (params.low_m - ray.origin_m) * inverse;
    let b = (params.high_m - ray.origin_m) * inverse;
    let near = max(largest(min(a, b)), 0.0);
    let far = smallest(max(a, b));
    if !(near < far) {
        return summary;
    }
    var t = max(near, ray.t_min);
    let end = min(far, ray.t_max);
    while t < end && summary.tau <= ray.stop_tau {
        let space = space_at(ray.origin_m + ray.direction * t);
        if !space.occupied {
            t = max(leave(ray, inverse, space), t) + params.nudge_m;
            continue;
        }
        let dt = min(max(space.step_m, params.step_growth * t), end - t);
        let at = t + ray.phase * dt;
        let sigma = sigma_at(ray.origin_m + ray.direction * at);
        if sigma > params.sigma_min {
            add_sample(&summary, first_sample, RaySample(at, dt, sigma));
        }
        t += max(dt, params.nudge_m);
    }
    return summary;
}

// Takes a sample: records it while there is room, and composites it.
fn add_sample(summary: ptr<function, RaySummary>, first_sample: u32, sample: RaySample) {
    if (*summary).sample_count < params.sample_capacity {
        samples[first_sample + (*summary).sample_count] = sample;
    }
    // weight = transmittance * alpha = exp(-tau) * (1 - exp(-sigma * dt)).
    let optical = sample.sigma * sample.dt;
    let weight = exp(-(*summary).tau) * (1.0 - exp(-optical));
    (*summary).tau += optical;
    (*summary).accumulation += weight;
    (*summary).weighted_distance_m += weight * sample.t;
    (*summary).sample_count += 1u;
}

// Distance at which the ray leaves an empty cube.
fn leave(ray: Ray, inverse: vec3<f32>, space: Space) -> f32 {
    let a = (space.corner_m - ray.origin_m) * inverse;
    let b = (space.corner_m + space.side_m - ray.origin_m) * inverse;
    return smallest(max(a, b));
}

// Componentwise 1 / v; division by zero is indeterminate in WGSL, so a zero becomes a very small number first.
fn reciprocal(v: vec3<f32>) -> vec3<f32> {
    return 1.0 / select(v, vec3<f32>(1e-30), v == vec3<f32>(0.0));
}

fn largest(v: vec3<f32>) -> f32 {
    return max(v.x, max(v.y, v.z));
}

fn smallest(v: vec3<f32>) -> f32 {
    return min(v.x, min(v.y, v.z));
}
