// Losses of every ray and their gradients by colours, densities, sky and exposures; one thread a ray.

override WORKGROUP_SIZE: u32;

// Less transmittance than this tells nothing about the sky.
const MIN_SKY: f32 = 1e-3;

@group(0) @binding(0) var<uniform> params: TrainParams;
@group(0) @binding(1) var<storage, read> rays: array<Ray>;
@group(0) @binding(2) var<storage, read> targets: array<RayTarget>;
@group(0) @binding(3) var<storage, read> summaries: array<RaySummary>;
@group(0) @binding(4) var<storage, read> samples: array<RaySample>;
@group(0) @binding(5) var<storage, read> weights: array<f32>;
@group(0) @binding(6) var<storage, read> slots: array<u32>;
@group(0) @binding(7) var<storage, read> first_points: array<u32>;
@group(0) @binding(8) var<storage, read> slot_colors: array<vec4<f32>>;
@group(0) @binding(9) var<storage, read> sky_grids: array<SkyGrid>;
@group(0) @binding(10) var<storage, read> sky_logits: array<f32>;
@group(0) @binding(11) var<storage, read> views: array<View>;
@group(0) @binding(12) var<storage, read_write> slot_color_gradients: array<vec4<f32>>;
@group(0) @binding(13) var<storage, read_write> points: array<GradientPoint>;
@group(0) @binding(14) var<storage, read_write> sky_gradients: array<atomic<u32>>;
@group(0) @binding(15) var<storage, read_write> ray_losses_out: array<RayLoss>;
@group(0) @binding(16) var<storage, read_write> view_sums: array<atomic<u32>>;
@group(0) @binding(17) var<storage, read> state: StepState;

// Derivatives by the exposure of a ray's view.
struct ByExposure {
    log_gain: vec3<f32>,
    bias: vec3<f32>,
}

// Sums along a ray.
struct Totals {
    color: vec3<f32>,
    accumulation: f32,
    // Sum of weight * t.
    range_m: f32,
    // Sum of weight * robust range error.
    range_error: f32,
    tau: f32,
    // Sum of weight * warped coordinate.
    moment: f32,
}

// Derivatives of a ray's losses that its samples share.
struct Slopes {
    // By the composited colour before exposure.
    color: vec3<f32>,
    // By the remainder: of the colour loss, and of the losses of density alone.
    end_of_color: f32,
    end_of_shape: f32,
    // By the composited range, and by the expected range error.
    range: f32,
    range_error: f32,
    // By every optical depth.
    tau: f32,
    distortion: f32,
}

@compute @workgroup_size(WORKGROUP_SIZE)
fn ray_losses(@builtin(global_invocation_id) id: vec3<u32>) {
    let ray = id.x;
    if ray >= params.ray_count {
        return;
    }
    let first = ray * params.sample_capacity;
    let count = min(summaries[ray].sample_count, params.sample_capacity);
    let totals = totals_of(ray, first, count);
    let end = max(1.0 - totals.accumulation, 0.0);
    var out = RayLoss(0.0, 0.0, -1.0, 0u);
    var slopes: Slopes;
    var by_exposure: ByExposure;
    if targets[ray].color_weight > 0.0 {
        color_slopes(ray, totals, end, &slopes, &out, &by_exposure);
    }
    if targets[ray].range_weight > 0.0 {
        range_slopes(ray, totals, end, &slopes, &out);
    }
    if targets[ray].silhouette != SILHOUETTE_UNKNOWN {
        silhouette_slopes(ray, totals, &slopes, &out);
    }
    differentiate(ray, first, count, totals, slopes, &out, &by_exposure);
    ray_losses_out[params.first_ray + ray] = out;
    if params.view_count > 0u {
        let first_sum = VIEW_SUMS * targets[ray].view;
        for (var c = 0u; c < 3u; c++) {
            add_to_view(first_sum + BY_LOG_GAIN + c, by_exposure.log_gain[c]);
            add_to_view(first_sum + BY_BIAS + c, by_exposure.bias[c]);
        }
    }
}

fn totals_of(ray: u32, first: u32, count: u32) -> Totals {
    let range_m = targets[ray].range_m;
    var totals: Totals;
    for (var i = first; i < first + count; i++) {
        let sample = samples[i];
        let weight = weights[i];
        totals.accumulation += weight;
        totals.tau += sample.sigma * sample.dt;
        totals.range_m += weight * sample.t;
        totals.range_error += weight * range_error(sample.t, range_m);
        totals.moment += weight * warped(sample.t, params.distortion_scale_m).x;
        if slots[i] != NO_SLOT {
            totals.color += weight * slot_colors[slots[i]].xyz;
        }
    }
    return totals;
}

// Robust error of one sample's range, at most the cap.
fn range_error(t: f32, range_m: f32) -> f32 {
    return min(depth_error(t - range_m, params.depth_scale_m), params.depth_cap_m);
}

// Loss of the composited colour, entropy of the remainder and what the sky learns.
fn color_slopes(
    ray: u32,
    totals: Totals,
    end: f32,
    slopes: ptr<function, Slopes>,
    out: ptr<function, RayLoss>,
    by_exposure: ptr<function, ByExposure>,
) {
    let goal = targets[ray];
    var behind = goal.backdrop;
    if goal.backdrop_kind == BACKDROP_SKY || goal.backdrop_kind == BACKDROP_SKY_AS_IS {
        behind = vec3<f32>(0.0);
        if params.sky_grid_count > 0u {
            behind = sky_color(rays[ray].direction);
        }
    }
    let color = behind * end + totals.color;
    let error = exposed(goal.view, color) - goal.color;
    let value = dot(error, error) / 3.0;
    (*out).squared_error = value;
    (*out).loss += goal.color_weight * value;
    (*out).is_color = 1u;
    let gradient = before_exposure(goal.view, color, error * (2.0 / 3.0) * goal.color_weight, by_exposure);
    (*slopes).color = gradient;
    (*slopes).end_of_color = dot(gradient, behind);
    if params.entropy > 0.0 {
        (*slopes).end_of_shape = goal.color_weight * params.entropy * entropy_slope(end);
    }
    (*slopes).distortion = goal.color_weight * params.distortion;
    if goal.backdrop_kind == BACKDROP_SKY && end > MIN_SKY {
        teach_sky(rays[ray].direction, end * gradient * behind * (1.0 - behind));
    }
}

// The colour as a view recorded it.
fn exposed(view: u32, color: vec3<f32>) -> vec3<f32> {
    if params.view_count == 0u {
        return color;
    }
    return gain_of(views[view].log_gain.xyz) * color + views[view].bias.xyz;
}

fn gain_of(log_gain: vec3<f32>) -> vec3<f32> {
    return vec3<f32>(exponential(log_gain.x), exponential(log_gain.y), exponential(log_gain.z));
}

// Takes a derivative by the exposed colour back to the colour, and adds the ones by the exposure.
fn before_exposure(
    view: u32,
    color: vec3<f32>,
    by_exposed: vec3<f32>,
    by_exposure: ptr<function, ByExposure>,
) -> vec3<f32> {
    if params.view_count == 0u {
        return by_exposed;
    }
    let gain = gain_of(views[view].log_gain.xyz);
    (*by_exposure).log_gain += gain * color * by_exposed;
    (*by_exposure).bias += by_exposed;
    return gain * by_exposed;
}

fn teach_sky(direction: vec3<f32>, by_logits: vec3<f32>) {
    for (var g = 0u; g < params.sky_grid_count; g++) {
        let at = sky_texels(sky_grids[g], direction);
        for (var i = 0u; i < 4u; i++) {
            let first = 3u * at.texels[i];
            add_to_sky(first, by_logits.x * at.weights[i]);
            add_to_sky(first + 1u, by_logits.y * at.weights[i]);
            add_to_sky(first + 2u, by_logits.z * at.weights[i]);
        }
    }
}

fn add_to_sky(at: u32, value: f32) {
    var old = atomicLoad(&sky_gradients[at]);
    loop {
        let sum = bitcast<u32>(bitcast<f32>(old) + value);
        let result = atomicCompareExchangeWeak(&sky_gradients[at], old, sum);
        if result.exchanged {
            break;
        }
        old = result.old_value;
    }
}

// Range error; the remainder is charged the cap.
fn range_slopes(
    ray: u32,
    totals: Totals,
    end: f32,
    slopes: ptr<function, Slopes>,
    out: ptr<function, RayLoss>,
) {
    let goal = targets[ray];
    let behind_m = goal.range_m + params.depth_cap_m;
    let error_m = end * behind_m + totals.range_m - goal.range_m;
    (*out).range_error_m = abs(error_m);
    let trim_m = select(params.depth_trim_m, state.depth_trim_m, params.trim_quantile > 0.0);
    if params.depth_is_composited != 0u {
        if abs(error_m) <= trim_m {
            let slope = goal.range_weight * sign(error_m);
            (*out).loss += goal.range_weight * abs(error_m);
            (*slopes).range = slope;
            (*slopes).end_of_shape += slope * behind_m;
        }
        return;
    }
    let expected = end * params.depth_cap_m + totals.range_error;
    if expected <= trim_m {
        (*out).loss += goal.range_weight * expected;
        (*slopes).range_error = goal.range_weight;
        (*slopes).end_of_shape += goal.range_weight * params.depth_cap_m;
    }
}

fn silhouette_slopes(ray: u32, totals: Totals, slopes: ptr<function, Slopes>, out: ptr<function, RayLoss>) {
    let weight = targets[ray].silhouette_weight;
    var loss = Loss(totals.tau, 1.0);
    if params.rectified_is_printed != 0u || targets[ray].silhouette == SILHOUETTE_OPAQUE {
        loss = opaque_loss(totals.tau);
    }
    (*out).loss += weight * loss.value;
    (*slopes).tau = weight * loss.slope;
}

// Gradients by every sample's colour and raw density, from the last sample to the first:
// dL/dtau_i = g_i T_(i+1) - sum_(j>i) g_j w_j - g_end T_end, for colour and for the losses of density alone.
fn differentiate(
    ray: u32,
    first: u32,
    count: u32,
    totals: Totals,
    slopes: Slopes,
    out: ptr<function, RayLoss>,
    by_exposure: ptr<function, ByExposure>,
) {
    let goal = targets[ray];
    let end = max(1.0 - totals.accumulation, 0.0);
    let per_sample = 2.0 * goal.color_weight * params.sample_color;
    var transmittance = end;
    var behind_color = slopes.end_of_color * end;
    var behind_shape = slopes.end_of_shape * end;
    var weight_after = 0.0;
    var moment_after = 0.0;
    for (var k = 1u; k <= count; k++) {
        let i = first + count - k;
        let sample = samples[i];
        let weight = weights[i];
        let slot = slots[i];
        var by_tau = slopes.tau;
        // A sample that was not coloured has an unknown colour, not black: colour says nothing about its density.
        if slot != NO_SLOT {
            let color = slot_colors[slot].xyz;
            let by_weight = dot(slopes.color, color);
            by_tau += by_weight * transmittance - behind_color;
            behind_color += by_weight * weight;
            let own = (exposed(goal.view, color) - goal.color) * (per_sample * weight);
            let by_color = before_exposure(goal.view, color, own, by_exposure);
            slot_color_gradients[slot] = vec4<f32>(weight * slopes.color + by_color, 0.0);
        }
        var by_weight = slopes.range * sample.t + slopes.range_error * range_error(sample.t, goal.range_m);
        let position = warped(sample.t, params.distortion_scale_m);
        let weight_before = totals.accumulation - weight_after - weight;
        let moment_before = totals.moment - moment_after - weight * position.x;
        let spread = position.x * (weight_before - weight_after) + moment_after - moment_before;
        let own_spread = weight * position.y * sample.dt / 3.0;
        (*out).loss += slopes.distortion * weight * (spread + own_spread);
        by_weight += slopes.distortion * 2.0 * (spread + own_spread);
        weight_after += weight;
        moment_after += weight * position.x;
        by_tau += by_weight * transmittance - behind_shape;
        behind_shape += by_weight * weight;
        transmittance += weight;
        let raw = by_tau * sample.dt * density_slope(sample.sigma);
        let place = rays[ray].origin_m + rays[ray].direction * sample.t;
        points[first_points[ray] + count - k] = GradientPoint(place, raw, slot);
    }
}

// Derivative of sigma by the raw density: the logistic of x is 1 - exp(-softplus(x)).
fn density_slope(sigma: f32) -> f32 {
    return -exponential_less_one(-sigma * params.base_voxel_m) / params.base_voxel_m;
}
