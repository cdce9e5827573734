// Adds the points' gradients to those of the nodes around them and marks their bricks; one thread a point, as many times as it takes.

override WORKGROUP_SIZE: u32;
// Quads of colour values a node has: one of direct colour, or three of features.
override QUADS: u32;

@group(0) @binding(0) var<uniform> params: GridParams;
@group(0) @binding(1) var<storage, read> counters: array<u32>;
@group(0) @binding(2) var<storage, read> points: array<GridPoint>;
// Gradients by the colour values of coloured samples.
@group(0) @binding(3) var<storage, read> slot_gradients: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read_write> density_gradients: array<atomic<u32>>;
// The last two hold nothing where a node has one quad.
@group(0) @binding(5) var<storage, read_write> gradients_a: array<atomic<u32>>;
@group(0) @binding(6) var<storage, read_write> gradients_b: array<atomic<u32>>;
@group(0) @binding(7) var<storage, read_write> gradients_c: array<atomic<u32>>;
// Step of a brick's last gradient.
@group(0) @binding(8) var<storage, read_write> brick_seen: array<atomic<u32>>;

@compute @workgroup_size(WORKGROUP_SIZE)
fn scatter_grid(
    @builtin(global_invocation_id) id: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
) {
    let count = counters[POINT_COUNT];
    for (var i = id.x; i < count; i += groups.x * WORKGROUP_SIZE) {
        let point = points[i];
        // What no loss of the point reads is not touched.
        if point.raw != 0.0 || point.slot != NO_SLOT {
            scatter(point);
        }
    }
}

fn scatter(point: GridPoint) {
    let cell = cell_at(point.q);
    for (var corner = 0u; corner < 8u; corner++) {
        let node = corner_node(cell, corner);
        let weight = corner_weight(cell, corner);
        let brick = node / NODES_PER_BRICK;
        if atomicLoad(&brick_seen[brick]) != params.step {
            atomicStore(&brick_seen[brick], params.step);
        }
        add_to_density(node, weight * point.raw);
        if point.slot == NO_SLOT {
            continue;
        }
        let a = weight * slot_gradients[QUADS * point.slot];
        for (var f = 0u; f < 4u; f++) {
            add_to_a(4u * node + f, a[f]);
        }
        if QUADS == 3u {
            let b = weight * slot_gradients[QUADS * point.slot + 1u];
            let c = weight * slot_gradients[QUADS * point.slot + 2u];
            for (var f = 0u; f < 4u; f++) {
                add_to_b(4u * node + f, b[f]);
                add_to_c(4u * node + f, c[f]);
            }
        }
    }
}
