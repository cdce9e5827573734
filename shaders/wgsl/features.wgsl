// Interpolated colour features of a pyramid: three quads, each in a buffer of its own, so that few outgrow a binding.

struct Features {
    a: vec4<f32>,
    b: vec4<f32>,
    c: vec4<f32>,
}

// Adds what the bound part of the nodes contributes to the sum of the levels' trilinear interpolations.
fn add_part(before: Features, point: vec3<f32>) -> Features {
    var sum = before;
    for (var l = 0u; l < part.level_count; l++) {
        let corners = corners_at(levels[l], point);
        for (var corner = 0u; corner < 8u; corner++) {
            // Wraps for nodes of the parts before: they are then beyond this one.
            let node = corners.nodes[corner] - part.first_node;
            if corners.stored && node < part.node_count {
                let weight = corners.weights[corner];
                sum.a += features_a[node] * weight;
                sum.b += features_b[node] * weight;
                sum.c += features_c[node] * weight;
            }
        }
    }
    return sum;
}
