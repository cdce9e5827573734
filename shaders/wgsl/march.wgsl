// Marching a ray through occupied space, sample by sample.

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
    // First ray of the dispatch.
    first_ray: u32,
}

// How far a ray has come.
struct Walk {
    inverse: vec3<f32>,
    t: f32,
    end: f32,
    // Optical depth so far.
    tau: f32,
}

fn begin_walk(ray: Ray) -> Walk {
    var walk: Walk;
    walk.inverse = reciprocal(ray.direction);
    let a = (params.low_m - ray.origin_m) * walk.inverse;
    let b = (params.high_m - ray.origin_m) * walk.inverse;
    let near = max(largest(min(a, b)), 0.0);
    let far = smallest(max(a, b));
    // A ray that misses the box has nothing to walk.
    walk.t = max(near, ray.t_min);
    walk.end = select(walk.t, min(far, ray.t_max), near < far);
    return walk;
}

// The next sample with density; one of length 0 at the end.
fn next_sample(ray: Ray, stop_tau: f32, walk: ptr<function, Walk>) -> RaySample {
    var sample: RaySample;
    while (*walk).t < (*walk).end && (*walk).tau <= stop_tau {
        let t = (*walk).t;
        let space = space_at(ray.origin_m + ray.direction * t);
        if !space.occupied {
            (*walk).t = max(leave(ray, (*walk).inverse, space), t) + params.nudge_m;
            continue;
        }
        let dt = min(max(space.step_m, params.step_growth * t), (*walk).end - t);
        let at = t + ray.phase * dt;
        let sigma = sigma_at(ray.origin_m + ray.direction * at);
        (*walk).t = t + max(dt, params.nudge_m);
        if sigma > params.sigma_min {
            (*walk).tau += sigma * dt;
            sample = RaySample(at, dt, sigma);
            break;
        }
    }
    return sample;
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
