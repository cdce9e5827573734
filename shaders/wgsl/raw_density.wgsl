// Interpolated raw density of a pyramid.

// Raw density at a point, and whether any level stores a brick there.
struct RawDensity {
    raw: f32,
    stored: bool,
}

// Sum of the levels' trilinear interpolations.
fn raw_density(point: vec3<f32>) -> RawDensity {
    var sum = RawDensity(0.0, false);
    for (var l = 0u; l < params.level_count; l++) {
        let corners = corners_at(levels[l], point);
        if corners.stored {
            var raw = 0.0;
            for (var corner = 0u; corner < 8u; corner++) {
                raw += node_density(corners.nodes[corner]) * corners.weights[corner];
            }
            sum.raw += raw;
            sum.stored = true;
        }
    }
    return sum;
}
