// Activation from raw density to sigma.

// softplus(x) = ln(1 + e^x), written so that e^x cannot overflow.
fn softplus(x: f32) -> f32 {
    return max(x, 0.0) + log(1.0 + exp(-abs(x)));
}

// sigma in 1/m from raw density (the act_shift form of DVGO, in metric units).
fn sigma_from_raw(raw: f32) -> f32 {
    return softplus(raw + params.act_shift) / params.base_voxel_m;
}
