// Interpolated colour features of a pyramid: three quads, each in a buffer of its own, so that none outgrows a binding.

struct Features {
    a: vec4<f32>,
    b: vec4<f32>,
    c: vec4<f32>,
}

// Sum of the levels' trilinear interpolations.
fn features_at(point: vec3<f32>) -> Features {
    var sum: Features;
    for (var l = 0u; l < params.level_count; l++) {
        let corners = corners_at(levels[l], point);
        if corners.stored {
            for (var corner = 0u; corner < 8u; corner++) {
                let node = corners.nodes[corner];
                let weight = corners.weights[corner];
                sum.a += features_a[node] * weight;
                sum.b += features_b[node] * weight;
                sum.c += features_c[node] * weight;
            }
        }
    }
    return sum;
}
