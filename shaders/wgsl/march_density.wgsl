// Marches one ray a thread through occupied space and records every sample it decides to take.

override WORKGROUP_SIZE: u32;

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
    let number = (group.y * params.groups_x + group.x) * WORKGROUP_SIZE + local;
    if number < params.ray_count {
        let ray_index = params.first_ray + number;
        summaries[ray_index] = march(rays[ray_index], ray_index * params.sample_capacity);
    }
}

fn march(ray: Ray, first_sample: u32) -> RaySummary {
    var summary: RaySummary;
    var walk = begin_walk(ray);
    loop {
        let sample = next_sample(ray, ray.stop_tau, &walk);
        if sample.dt <= 0.0 {
            break;
        }
        add_sample(&summary, first_sample, sample);
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
