// The far field: colour logits over directions, grids coarse to fine.

// The four texels around a direction, numbered over all grids, and their bilinear weights.
struct SkyTexels {
    texels: array<u32, 4>,
    weights: array<f32, 4>,
}

fn sky_texels(grid: SkyGrid, direction: vec3<f32>) -> SkyTexels {
    let elevation = arctangent(direction.z, length(direction.xy));
    let size = vec2<f32>(f32(grid.width), f32(grid.height));
    let at = (vec2<f32>(arctangent(direction.y, direction.x) / (2.0 * PI), elevation / PI) + 0.5) * size - 0.5;
    let base = vec2<i32>(floor(at));
    let f = at - vec2<f32>(base);
    let width = i32(grid.width);
    let left = u32((base.x + width) % width);
    let right = (left + 1u) % grid.width;
    let low = grid.start + grid.width * u32(clamp(base.y, 0, i32(grid.height) - 1));
    let high = grid.start + grid.width * u32(clamp(base.y + 1, 0, i32(grid.height) - 1));
    return SkyTexels(
        array<u32, 4>(low + left, low + right, high + left, high + right),
        array<f32, 4>((1.0 - f.x) * (1.0 - f.y), f.x * (1.0 - f.y), (1.0 - f.x) * f.y, f.x * f.y),
    );
}

// sRGB at infinity.
fn sky_color(direction: vec3<f32>) -> vec3<f32> {
    var sum = vec3<f32>(0.0);
    for (var g = 0u; g < params.sky_grid_count; g++) {
        let at = sky_texels(sky_grids[g], direction);
        for (var i = 0u; i < 4u; i++) {
            let first = 3u * at.texels[i];
            sum += vec3<f32>(sky_logits[first], sky_logits[first + 1u], sky_logits[first + 2u]) * at.weights[i];
        }
    }
    return vec3<f32>(sigmoid(sum.x), sigmoid(sum.y), sigmoid(sum.z));
}
