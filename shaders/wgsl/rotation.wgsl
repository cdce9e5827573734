// Rotations as unit quaternions (x, y, z, real part).

fn rotated(q: vec4<f32>, v: vec3<f32>) -> vec3<f32> {
    return v * (q.w * q.w - dot(q.xyz, q.xyz)) + q.xyz * (2.0 * dot(v, q.xyz)) + cross(q.xyz, v) * (2.0 * q.w);
}

// The rotation by b, then by a.
fn after(a: vec4<f32>, b: vec4<f32>) -> vec4<f32> {
    return vec4<f32>(a.w * b.xyz + b.w * a.xyz + cross(a.xyz, b.xyz), a.w * b.w - dot(a.xyz, b.xyz));
}

// The rotation about an axis by the axis's length, up to 2 rad.
fn from_scaled_axis(v: vec3<f32>) -> vec4<f32> {
    let angle = length(v);
    if angle == 0.0 {
        return vec4<f32>(0.0, 0.0, 0.0, 1.0);
    }
    let half = vec3<f32>(0.5 * angle);
    return vec4<f32>(v * (sine(half).x / angle), cosine(half).x);
}

fn scaled_axis(q: vec4<f32>) -> vec3<f32> {
    let size = length(q.xyz);
    if size < 1e-8 {
        return vec3<f32>(0.0);
    }
    return q.xyz * (2.0 * arctangent(size, q.w) / size);
}

// About the x-z plane.
fn reflected(v: vec3<f32>) -> vec3<f32> {
    return vec3<f32>(v.x, -v.y, v.z);
}
