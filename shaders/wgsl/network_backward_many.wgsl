// network_backward with sixteen samples a thread.

override WORKGROUP_SIZE: u32;

@group(0) @binding(0) var<uniform> layer_1: array<mat4x4<f32>, 320>;
@group(0) @binding(1) var<uniform> layer_2: array<mat4x4<f32>, 1024>;
@group(0) @binding(2) var<uniform> layer_3: array<mat4x4<f32>, 65>;
@group(0) @binding(3) var<storage, read> counters: array<u32>;
@group(0) @binding(4) var<storage, read> hidden_a: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read> hidden_b: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read> slot_colors: array<vec4<f32>>;
// By the colours before, by the sums of the last layer after.
@group(0) @binding(7) var<storage, read_write> slot_color_gradients: array<vec4<f32>>;
@group(0) @binding(8) var<storage, read_write> gradients_a: array<vec4<f32>>;
@group(0) @binding(9) var<storage, read_write> gradients_b: array<vec4<f32>>;
@group(0) @binding(10) var<storage, read_write> slot_gradients: array<vec4<f32>>;

@compute @workgroup_size(WORKGROUP_SIZE)
fn network_backward_many(
    @builtin(global_invocation_id) id: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
) {
    let count = counters[COLORED_COUNT];
    for (var slot = MANY * id.x; slot < count; slot += MANY * groups.x * WORKGROUP_SIZE) {
        backward(slot);
    }
}

// Slots past the last hold leavings; what comes of those is read by nobody.
fn backward(slot: u32) {
    let by_out = Tiles(
        by_sums(slot),
        by_sums(slot + TILE),
        by_sums(slot + 2u * TILE),
        by_sums(slot + 3u * TILE),
    );
    var by_b: Hidden;
    for (var row = 0u; row < WIDTH_BLOCKS; row++) {
        let back = multiply_back(Tiles(), layer_3[row], by_out);
        by_b[row] = Tiles(
            through_b(slot, row, back.a),
            through_b(slot + TILE, row, back.b),
            through_b(slot + 2u * TILE, row, back.c),
            through_b(slot + 3u * TILE, row, back.d),
        );
    }
    var by_features: array<Tiles, FEATURE_BLOCKS>;
    for (var row = 0u; row < WIDTH_BLOCKS; row++) {
        let back = back_to_hidden(row, &by_b);
        let gradient = Tiles(
            through_a(slot, row, back.a),
            through_a(slot + TILE, row, back.b),
            through_a(slot + 2u * TILE, row, back.c),
            through_a(slot + 3u * TILE, row, back.d),
        );
        let w = row * INPUT_BLOCKS;
        by_features[0] = multiply_back(by_features[0], layer_1[w], gradient);
        by_features[1] = multiply_back(by_features[1], layer_1[w + 1u], gradient);
        by_features[2] = multiply_back(by_features[2], layer_1[w + 2u], gradient);
    }
    store_gradients(slot, by_features[0].a, by_features[1].a, by_features[2].a);
    store_gradients(slot + TILE, by_features[0].b, by_features[1].b, by_features[2].b);
    store_gradients(slot + 2u * TILE, by_features[0].c, by_features[1].c, by_features[2].c);
    store_gradients(slot + 3u * TILE, by_features[0].d, by_features[1].d, by_features[2].d);
}

fn by_sums(slot: u32) -> Tile {
    return Tile(by_sum(slot), by_sum(slot + 1u), by_sum(slot + 2u), by_sum(slot + 3u));
}

// Takes a slot's colour gradient through the logistic: c (1 - c).
fn by_sum(slot: u32) -> vec4<f32> {
    let color = slot_colors[slot];
    let gradient = slot_color_gradients[slot] * color * (1.0 - color);
    slot_color_gradients[slot] = gradient;
    return gradient;
}

// Gradients by the second hidden layer's neurons, kept for its weights.
fn through_b(slot: u32, row: u32, back: Tile) -> Tile {
    let at = slot * WIDTH_BLOCKS + row;
    let neurons = Tile(
        hidden_b[at],
        hidden_b[at + WIDTH_BLOCKS],
        hidden_b[at + 2u * WIDTH_BLOCKS],
        hidden_b[at + 3u * WIDTH_BLOCKS],
    );
    let gradient = where_positive(neurons, back);
    gradients_b[at] = gradient[0];
    gradients_b[at + WIDTH_BLOCKS] = gradient[1];
    gradients_b[at + 2u * WIDTH_BLOCKS] = gradient[2];
    gradients_b[at + 3u * WIDTH_BLOCKS] = gradient[3];
    return gradient;
}

// The same for the first one.
fn through_a(slot: u32, row: u32, back: Tile) -> Tile {
    let at = slot * WIDTH_BLOCKS + row;
    let neurons = Tile(
        hidden_a[at],
        hidden_a[at + WIDTH_BLOCKS],
        hidden_a[at + 2u * WIDTH_BLOCKS],
        hidden_a[at + 3u * WIDTH_BLOCKS],
    );
    let gradient = where_positive(neurons, back);
    gradients_a[at] = gradient[0];
    gradients_a[at + WIDTH_BLOCKS] = gradient[1];
    gradients_a[at + 2u * WIDTH_BLOCKS] = gradient[2];
    gradients_a[at + 3u * WIDTH_BLOCKS] = gradient[3];
    return gradient;
}

fn store_gradients(slot: u32, a: Tile, b: Tile, c: Tile) {
    let out = 3u * slot;
    slot_gradients[out] = a[0];
    slot_gradients[out + 1u] = b[0];
    slot_gradients[out + 2u] = c[0];
    slot_gradients[out + 3u] = a[1];
    slot_gradients[out + 4u] = b[1];
    slot_gradients[out + 5u] = c[1];
    slot_gradients[out + 6u] = a[2];
    slot_gradients[out + 7u] = b[2];
    slot_gradients[out + 8u] = c[2];
    slot_gradients[out + 9u] = a[3];
    slot_gradients[out + 10u] = b[3];
    slot_gradients[out + 11u] = c[3];
}
