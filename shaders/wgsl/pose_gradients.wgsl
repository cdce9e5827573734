// Gradients by the poses of views, from those by density and features through the interpolation of what one part of the nodes holds; one
// thread a ray. Where along the ray the samples lie, and the direction that the colour network is told, are held constant.

override WORKGROUP_SIZE: u32;

@group(0) @binding(0) var<uniform> params: TrainParams;
@group(0) @binding(1) var<uniform> part: PartParams;
@group(0) @binding(2) var<storage, read> levels: array<Level>;
@group(0) @binding(3) var<storage, read> brick_index: array<u32>;
@group(0) @binding(4) var<storage, read> density: array<f32>;
@group(0) @binding(5) var<storage, read> features_a: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read> features_b: array<vec4<f32>>;
@group(0) @binding(7) var<storage, read> features_c: array<vec4<f32>>;
@group(0) @binding(8) var<storage, read> targets: array<RayTarget>;
@group(0) @binding(9) var<storage, read> summaries: array<RaySummary>;
@group(0) @binding(10) var<storage, read> first_points: array<u32>;
@group(0) @binding(11) var<storage, read> points: array<GradientPoint>;
@group(0) @binding(12) var<storage, read> slot_gradients: array<vec4<f32>>;
@group(0) @binding(13) var<storage, read> views: array<View>;
@group(0) @binding(14) var<storage, read_write> view_sums: array<atomic<u32>>;

@compute @workgroup_size(WORKGROUP_SIZE)
fn pose_gradients(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= params.ray_count {
        return;
    }
    let goal = targets[id.x];
    let centre = views[goal.view].translation_m.xyz;
    let first = first_points[id.x];
    let count = min(summaries[id.x].sample_count, params.sample_capacity);
    var by_rotation = vec3<f32>(0.0);
    var by_translation = vec3<f32>(0.0);
    for (var p = first; p < first + count; p++) {
        let point = points[p];
        if point.raw == 0.0 && point.slot == NO_SLOT {
            continue;
        }
        var slope = slope_at(point);
        var position = point.position_m;
        if goal.mirrored != 0u {
            slope = reflected(slope);
            position = reflected(position);
        }
        by_translation += slope;
        by_rotation += cross(position - centre, slope);
    }
    let first_sum = VIEW_SUMS * goal.view;
    for (var c = 0u; c < 3u; c++) {
        add_to_view(first_sum + BY_ROTATION + c, by_rotation[c]);
        add_to_view(first_sum + BY_TRANSLATION + c, by_translation[c]);
    }
}

// Gradient by position of the point's raw density and features, each times its own gradient.
fn slope_at(point: GradientPoint) -> vec3<f32> {
    var sum = vec3<f32>(0.0);
    for (var l = 0u; l < part.level_count; l++) {
        let corners = corners_at(levels[l], point.position_m);
        for (var corner = 0u; corner < 8u; corner++) {
            // Wraps for nodes of the parts before: they are then beyond this one.
            let node = corners.nodes[corner] - part.first_node;
            if corners.stored && node < part.node_count {
                let value = value_of(point, node, corners.nodes[corner] - part.first_density);
                sum += value / levels[l].voxel_m * vec3<f32>(
                    along(corners, corner, 1u),
                    along(corners, corner, 2u),
                    along(corners, corner, 4u),
                );
            }
        }
    }
    return sum;
}

// A node's raw density and features, each times the point's gradient by it.
fn value_of(point: GradientPoint, node: u32, density_at: u32) -> f32 {
    var value = point.raw * density[density_at];
    if point.slot != NO_SLOT {
        let row = 3u * point.slot;
        value += dot(features_a[node], slot_gradients[row]);
        value += dot(features_b[node], slot_gradients[row + 1u]);
        value += dot(features_c[node], slot_gradients[row + 2u]);
    }
    return value;
}

// Derivative of a corner's weight along an axis, in voxels: a pair's weights sum to the product of the two other axes' fractions.
fn along(corners: Corners, corner: u32, axis_bit: u32) -> f32 {
    let size = corners.weights[corner] + corners.weights[corner ^ axis_bit];
    return select(-size, size, (corner & axis_bit) != 0u);
}
