// Activation from raw density to sigma.

// Density in 1/m at a point, 0 where no level stores anything.
fn sigma_at(point: vec3<f32>) -> f32 {
    let density = raw_density(point);
    return select(0.0, softplus(density.raw + params.act_shift) / params.base_voxel_m, density.stored);
}

// ln(1 + e^x) without overflow.
fn softplus(x: f32) -> f32 {
    return max(x, 0.0) + log1p(exp(-abs(x)));
}

// ln(1 + x) for x in [0, 1]. WGSL has no log1p, and the error of its log near 1 is absolute (2^-21): a series below 1/32.
fn log1p(x: f32) -> f32 {
    if x < 0.03125 {
        return x * (1.0 - x * (0.5 - x * (1.0 / 3.0 - 0.25 * x)));
    }
    return log(1.0 + x);
}
