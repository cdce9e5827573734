// Marches one ray a thread through a density pyramid and records every sample it decides to take.

override WORKGROUP_SIZE: u32;

struct MarchParams {
    // Length in metres that raw densities are activated for.
    base_voxel_m: f32,
    // Shift of raw density before the activation.
    act_shift: f32,
    // Marching ends after the sample that brings tau above this.
    stop_tau: f32,
    // Interval length, metres.
    step_m: f32,
    level_count: u32,
    ray_count: u32,
    // Samples kept per ray; a ray that needs more says so in sample_count.
    sample_capacity: u32,
    // Workgroups along x of the dispatch, for grids beyond one dimension's limit.
    groups_x: u32,
}

@group(0) @binding(0) var<uniform> params: MarchParams;
@group(0) @binding(1) var<storage, read> levels: array<Level>;
@group(0) @binding(2) var<storage, read> brick_index: array<u32>;
@group(0) @binding(3) var<storage, read> density: array<f32>;
@group(0) @binding(4) var<storage, read> rays: array<Ray>;
@group(0) @binding(5) var<storage, read_write> summaries: array<RaySummary>;
@group(0) @binding(6) var<storage, read_write> samples: array<RaySample>;

@compute @workgroup_size(WORKGROUP_SIZE)
fn march_density(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let ray_index = (group.y * params.groups_x + group.x) * WORKGROUP_SIZE + local;
    if ray_index >= params.ray_count {
        return;
    }
    summaries[ray_index] = march(ray_index, rays[ray_index]);
}

fn march(ray_index: u32, ray: Ray) -> RaySummary {
    var summary: RaySummary;
    let intervals = u32(max(ceil((ray.t_far - ray.t_near) / params.step_m), 0.0));
    for (var i = 0u; i < intervals; i++) {
        let start = ray.t_near + f32(i) * params.step_m;
        let delta = min(params.step_m, ray.t_far - start);
        let t = start + 0.5 * delta;
        let sigma = sigma_from_raw(raw_density(ray.origin + t * ray.direction));
        if summary.sample_count < params.sample_capacity {
            samples[ray_index * params.sample_capacity + summary.sample_count] = RaySample(t, delta, sigma);
        }
        summary.sample_count += 1u;
        // weight = exp(-tau) * (1 - exp(-sigma * delta)).
        let weight = exp(-summary.tau) * (1.0 - exp(-sigma * delta));
        summary.tau += sigma * delta;
        summary.depth_m += weight * t;
        if summary.tau > params.stop_tau {
            break;
        }
    }
    summary.accumulation = 1.0 - exp(-summary.tau);
    return summary;
}
