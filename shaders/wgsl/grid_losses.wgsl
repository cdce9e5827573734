// Losses of rays through a dense grid (the image's error, the entropy of the light left, every sample's own error) and their gradients by
// colours and raw densities; one thread a ray.

override WORKGROUP_SIZE: u32;
// Whether colours come from the grid itself: their gradients are then taken through the logistic here, not by the network.
override IS_DIRECT: bool;

@group(0) @binding(0) var<uniform> params: GridParams;
@group(0) @binding(1) var<storage, read> rays: array<PixelRay>;
@group(0) @binding(2) var<storage, read> lights: array<RayLight>;
@group(0) @binding(3) var<storage, read> samples: array<GridSample>;
@group(0) @binding(4) var<storage, read> slot_colors: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read_write> slot_color_gradients: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read_write> points: array<GridPoint>;
@group(0) @binding(7) var<storage, read_write> ray_losses_out: array<RayLoss>;

@compute @workgroup_size(WORKGROUP_SIZE)
fn grid_losses(@builtin(global_invocation_id) id: vec3<u32>) {
    let ray = id.x;
    if ray >= params.ray_count {
        return;
    }
    let first = ray * params.sample_capacity;
    let light = lights[ray];
    let goal = rays[ray].color;
    var color = params.backdrop * light.left;
    for (var i = first; i < first + light.sample_count; i++) {
        if samples[i].slot != NO_SLOT {
            color += samples[i].weight * slot_colors[samples[i].slot].xyz;
        }
    }
    let error = color - goal;
    let squared_error = dot(error, error) / 3.0;
    let by_color = 2.0 * error / 3.0 * params.ray_share;
    let by_end = dot(by_color, params.backdrop) + params.ray_share * params.entropy * entropy_slope(light.left);
    let own = differentiate(first, light, goal, by_color, by_end);
    let loss = squared_error + params.entropy * entropy(light.left) + params.sample_color * own;
    // There is no range, and every ray has a colour.
    ray_losses_out[params.first_ray + ray] = RayLoss(squared_error, loss * params.ray_share, -1.0, 1u);
}

fn entropy(light: f32) -> f32 {
    let p = clamp(light, ENTROPY_MIN, 1.0 - ENTROPY_MIN);
    let q = 1.0 - p;
    return -(p * log(p) + q * log(q));
}

// Gradients from the last sample to the first: dL/dtau_i = g_i T_(i+1) - sum_(j>i) g_j w_j - g_end T_end. Returns the samples' own errors.
fn differentiate(first: u32, light: RayLight, goal: vec3<f32>, by_color: vec3<f32>, by_end: f32) -> f32 {
    let own_share = params.sample_color * params.ray_share;
    var own = 0.0;
    var transmittance = light.left;
    var behind = by_end * light.left;
    for (var k = light.sample_count; k > 0u; k--) {
        let sample = samples[first + k - 1u];
        var by_weight = 0.0;
        if sample.slot != NO_SLOT {
            let color = slot_colors[sample.slot].xyz;
            let error = color - goal;
            own += sample.weight * dot(error, error);
            var gradient = sample.weight * by_color + own_share * (2.0 * sample.weight * error);
            if IS_DIRECT {
                gradient *= color * (1.0 - color);
            }
            slot_color_gradients[sample.slot] = vec4<f32>(gradient, 0.0);
            by_weight = dot(by_color, color);
        }
        let by_tau = by_weight * transmittance - behind;
        behind += by_weight * sample.weight;
        transmittance += sample.weight;
        points[light.first_point + k - 1u] = GridPoint(sample.q, by_tau * sample.slope, sample.slot);
    }
    return own;
}
