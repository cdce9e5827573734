// Activation from raw density to sigma.

// Density in 1/m at a point, 0 where no level stores anything.
fn sigma_at(point: vec3<f32>) -> f32 {
    let density = raw_density(point);
    return select(0.0, softplus(density.raw + params.act_shift) / params.base_voxel_m, density.stored);
}
