// Rays of a camera in a field's frame; one thread a ray.

override WORKGROUP_SIZE: u32;

// Steps of the lens models' inversion; both converge to f32 rounding long before for every lens a car carries.
const BROWN_CONRADY_STEPS: u32 = 40u;
const KANNALA_BRANDT_STEPS: u32 = 20u;
const FAR_M: f32 = 3.0e38;

@group(0) @binding(0) var<uniform> params: EyeParams;
@group(0) @binding(1) var<storage, read> requests: array<RayRequest>;
@group(0) @binding(2) var<storage, read_write> rays: array<Ray>;
@group(0) @binding(3) var<storage, read_write> hits: array<RayHit>;

@compute @workgroup_size(WORKGROUP_SIZE)
fn eye_rays(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let number = (group.y * params.groups_x + group.x) * WORKGROUP_SIZE + local;
    if number >= params.ray_count {
        return;
    }
    let request = requests[params.first_ray + number];
    let part = vec2<f32>(f32(request.sub % request.side), f32(request.sub / request.side)) + 0.5;
    let pixel = vec2<f32>(f32(request.x), f32(request.y)) + part / f32(request.side);
    let focal = vec2<f32>(params.focal_x_px, params.focal_y_px);
    let seen = (pixel - vec2<f32>(params.principal_x_px, params.principal_y_px)) / focal;
    let direction = normalize(vec3<f32>(undistorted(seen), 1.0));
    var ray: Ray;
    ray.origin_m = params.origin_m;
    ray.direction = normalize(params.right * direction.x + params.down * direction.y + params.forward * direction.z);
    ray.t_max = FAR_M;
    ray.stop_tau = params.stop_tau;
    ray.phase = 0.5;
    rays[params.first_ray + number] = ray;
    hits[params.first_ray + number] = RayHit(1.0, -1.0, -1.0, direction.z);
}

// Inverts the lens: normalised image coordinates without distortion.
fn undistorted(seen: vec2<f32>) -> vec2<f32> {
    if params.distortion == BROWN_CONRADY {
        var n = seen;
        for (var i = 0u; i < BROWN_CONRADY_STEPS; i++) {
            n += seen - brown_conrady(n);
        }
        return n;
    }
    if params.distortion == KANNALA_BRANDT {
        return kannala_brandt_inverse(seen);
    }
    return seen;
}

fn brown_conrady(n: vec2<f32>) -> vec2<f32> {
    let r2 = dot(n, n);
    let radial = 1.0 + r2 * (params.k.x + r2 * (params.k.y + r2 * params.k3));
    return vec2<f32>(
        n.x * radial + 2.0 * params.k.z * n.x * n.y + params.k.w * (r2 + 2.0 * n.x * n.x),
        n.y * radial + params.k.z * (r2 + 2.0 * n.y * n.y) + 2.0 * params.k.w * n.x * n.y,
    );
}

fn kannala_brandt_inverse(seen: vec2<f32>) -> vec2<f32> {
    let distance = length(seen);
    if distance < 1e-6 {
        return seen;
    }
    var theta = distance;
    for (var i = 0u; i < KANNALA_BRANDT_STEPS; i++) {
        let t2 = theta * theta;
        let value = theta * (1.0 + t2 * (params.k.x + t2 * (params.k.y + t2 * (params.k.z + t2 * params.k.w))));
        let slope = 1.0 + t2 * (3.0 * params.k.x + t2 * (5.0 * params.k.y + t2 * (7.0 * params.k.z + t2 * 9.0 * params.k.w)));
        theta -= (value - distance) / slope;
    }
    return seen * (tan(theta) / distance);
}
