// Adds the points' gradients to those of the nodes around them that one part holds; one thread a point and a
// level, as many times as it takes.

override WORKGROUP_SIZE: u32;

@group(0) @binding(0) var<uniform> part: PartParams;
@group(0) @binding(1) var<storage, read> levels: array<Level>;
@group(0) @binding(2) var<storage, read> brick_index: array<u32>;
@group(0) @binding(3) var<storage, read> counters: array<u32>;
@group(0) @binding(4) var<storage, read> points: array<GradientPoint>;
// Gradients by the features of coloured samples.
@group(0) @binding(5) var<storage, read> slot_gradients: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read_write> density_gradients: array<atomic<u32>>;
@group(0) @binding(7) var<storage, read_write> gradients_a: array<atomic<u32>>;
@group(0) @binding(8) var<storage, read_write> gradients_b: array<atomic<u32>>;
@group(0) @binding(9) var<storage, read_write> gradients_c: array<atomic<u32>>;
// 1 for bricks that are in the list.
@group(0) @binding(10) var<storage, read_write> brick_marks: array<atomic<u32>>;
// Number of bricks with gradients, and their list.
@group(0) @binding(11) var<storage, read_write> touched_bricks: array<atomic<u32>>;

@compute @workgroup_size(WORKGROUP_SIZE)
fn scatter_gradients(
    @builtin(global_invocation_id) id: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
) {
    // One loop over pairs of points and levels: software adapters pay dearly for loops within loops.
    let count = counters[POINT_COUNT] * part.level_count;
    for (var i = id.x; i < count; i += groups.x * WORKGROUP_SIZE) {
        let point = points[i / part.level_count];
        // Nothing to add, and bricks that only such points read are not touched.
        if point.raw != 0.0 || point.slot != NO_SLOT {
            scatter(point, corners_at(levels[i % part.level_count], point.position_m));
        }
    }
}

fn scatter(point: GradientPoint, corners: Corners) {
    var last_brick = 0u;
    for (var corner = 0u; corner < 8u; corner++) {
        let brick = corners.nodes[corner] / NODES_PER_BRICK;
        // Wraps for nodes of the parts before: they are then beyond this one.
        let node = corners.nodes[corner] - part.first_node;
        // The null brick never learns.
        if brick == 0u || node >= part.node_count {
            continue;
        }
        if brick != last_brick {
            touch(brick);
            last_brick = brick;
        }
        let weight = corners.weights[corner];
        add_to_density(node, weight * point.raw);
        if point.slot != NO_SLOT {
            let a = slot_gradients[3u * point.slot] * weight;
            let b = slot_gradients[3u * point.slot + 1u] * weight;
            let c = slot_gradients[3u * point.slot + 2u] * weight;
            for (var f = 0u; f < 4u; f++) {
                add_to_a(4u * node + f, a[f]);
                add_to_b(4u * node + f, b[f]);
                add_to_c(4u * node + f, c[f]);
            }
        }
    }
}

// Lists a brick once a step.
fn touch(brick: u32) {
    if atomicLoad(&brick_marks[brick]) == 0u && atomicExchange(&brick_marks[brick], 1u) == 0u {
        let place = atomicAdd(&touched_bricks[0], 1u);
        atomicStore(&touched_bricks[1u + place], brick);
    }
}
