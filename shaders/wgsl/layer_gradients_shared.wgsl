// layer_gradients whose threads read together, for software adapters: eight threads of a subgroup take 16 neurons each of one side of the
// layer, and every one of them eight quads of the other side, of which each thread reads one. One workgroup those quads and a share of the
// samples, two at a time.

override WORKGROUP_SIZE: u32;
// Which side is divided among the threads: the layer's inputs, or its outputs. Inputs only where there is one quad of outputs.
override TAKES_INPUTS: bool;

const LANES: u32 = 8u;
// Quads of neurons that a thread takes.
const OWN_QUADS: u32 = 4u;

@group(0) @binding(0) var<uniform> layer: LayerParams;
@group(0) @binding(1) var<storage, read> counters: array<u32>;
@group(0) @binding(2) var<storage, read> layer_inputs: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> output_gradients: array<vec4<f32>>;
// Every share's sums, one share after the other.
@group(0) @binding(4) var<storage, read_write> weight_gradients: array<mat4x4<f32>>;

// A thread's quads of a sample.
alias Own = array<vec4<f32>, OWN_QUADS>;
// Sums over samples for one quad of the other side: a column is one of its neurons, a row one of the thread's.
alias Tile = array<mat4x4<f32>, OWN_QUADS>;

@compute @workgroup_size(WORKGROUP_SIZE)
fn layer_gradients_shared(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(subgroup_invocation_id) own_lane: u32,
) {
    let lane = own_lane % LANES;
    let tiles = (other_quads() + LANES - 1u) / LANES;
    let share = group.x / tiles;
    if share >= layer.shares {
        return;
    }
    let own = OWN_QUADS * lane;
    let other = LANES * (group.x % tiles);
    var tile_0: Tile;
    var tile_1: Tile;
    var tile_2: Tile;
    var tile_3: Tile;
    var tile_4: Tile;
    var tile_5: Tile;
    var tile_6: Tile;
    var tile_7: Tile;
    var own_sums: Own;
    var other_sum: vec4<f32>;
    let count = counters[COLORED_COUNT];
    for (var slot = share; slot < count; slot += 2u * layer.shares) {
        // Of an odd number of samples the last is taken once more, with the weight 0.
        let next = min(slot + layer.shares, count - 1u);
        let weight = select(0.0, 1.0, slot + layer.shares < count);
        let x = own_of(slot, own);
        let y = weighted(own_of(next, own), weight);
        let a = other_quad(slot, other + lane);
        let b = other_quad(next, other + lane);
        add_own(&own_sums, x, y);
        other_sum += a + weight * b;
        add(&tile_0, x, y, subgroupBroadcast(a, 0u), subgroupBroadcast(b, 0u));
        if !TAKES_INPUTS {
            add(&tile_1, x, y, subgroupBroadcast(a, 1u), subgroupBroadcast(b, 1u));
            add(&tile_2, x, y, subgroupBroadcast(a, 2u), subgroupBroadcast(b, 2u));
            add(&tile_3, x, y, subgroupBroadcast(a, 3u), subgroupBroadcast(b, 3u));
            add(&tile_4, x, y, subgroupBroadcast(a, 4u), subgroupBroadcast(b, 4u));
            add(&tile_5, x, y, subgroupBroadcast(a, 5u), subgroupBroadcast(b, 5u));
            add(&tile_6, x, y, subgroupBroadcast(a, 6u), subgroupBroadcast(b, 6u));
            add(&tile_7, x, y, subgroupBroadcast(a, 7u), subgroupBroadcast(b, 7u));
        }
    }
    let first = share * layer.weight_blocks;
    store(first, own, other, tile_0);
    if !TAKES_INPUTS {
        store(first, own, other + 1u, tile_1);
        store(first, own, other + 2u, tile_2);
        store(first, own, other + 3u, tile_3);
        store(first, own, other + 4u, tile_4);
        store(first, own, other + 5u, tile_5);
        store(first, own, other + 6u, tile_6);
        store(first, own, other + 7u, tile_7);
    }
    store_biases(first, lane, other, own_sums, other_sum);
}

fn own_quads() -> u32 {
    return select(layer.output_quads, layer.input_quads, TAKES_INPUTS);
}

fn other_quads() -> u32 {
    return select(layer.input_quads, layer.output_quads, TAKES_INPUTS);
}

// Quads past the last repeat it; what they sum is not stored.
fn own_of(slot: u32, first: u32) -> Own {
    let last = own_quads() - 1u;
    let at = slot * own_quads();
    return Own(
        own_quad(at + min(first, last)),
        own_quad(at + min(first + 1u, last)),
        own_quad(at + min(first + 2u, last)),
        own_quad(at + min(first + 3u, last)),
    );
}

fn own_quad(at: u32) -> vec4<f32> {
    if TAKES_INPUTS {
        return layer_inputs[at];
    }
    return output_gradients[at];
}

fn other_quad(slot: u32, quad: u32) -> vec4<f32> {
    let at = slot * other_quads() + min(quad, other_quads() - 1u);
    if TAKES_INPUTS {
        return output_gradients[at];
    }
    return layer_inputs[at];
}

fn weighted(own: Own, weight: f32) -> Own {
    return Own(own[0] * weight, own[1] * weight, own[2] * weight, own[3] * weight);
}

fn add_own(sums: ptr<function, Own>, x: Own, y: Own) {
    (*sums)[0] += x[0] + y[0];
    (*sums)[1] += x[1] + y[1];
    (*sums)[2] += x[2] + y[2];
    (*sums)[3] += x[3] + y[3];
}

// Two samples' products of the thread's quads and another one.
fn add(tile: ptr<function, Tile>, x: Own, y: Own, a: vec4<f32>, b: vec4<f32>) {
    (*tile)[0] = add_outer((*tile)[0], x[0], y[0], a, b);
    (*tile)[1] = add_outer((*tile)[1], x[1], y[1], a, b);
    (*tile)[2] = add_outer((*tile)[2], x[2], y[2], a, b);
    (*tile)[3] = add_outer((*tile)[3], x[3], y[3], a, b);
}

fn add_outer(sum: mat4x4<f32>, x: vec4<f32>, y: vec4<f32>, a: vec4<f32>, b: vec4<f32>) -> mat4x4<f32> {
    return mat4x4<f32>(
        sum[0] + x * a.x + y * b.x,
        sum[1] + x * a.y + y * b.y,
        sum[2] + x * a.z + y * b.z,
        sum[3] + x * a.w + y * b.w,
    );
}

fn store(first: u32, own: u32, other: u32, tile: Tile) {
    if other >= other_quads() {
        return;
    }
    var blocks = tile;
    for (var i = 0u; i < OWN_QUADS; i++) {
        if own + i >= own_quads() {
            return;
        }
        // A block's columns are inputs, its rows outputs.
        if TAKES_INPUTS {
            add_block(first + layer.first_block + other * layer.input_quads + own + i, transpose(blocks[i]));
        } else {
            add_block(first + layer.first_block + (own + i) * layer.input_quads + other, blocks[i]);
        }
    }
}

fn add_block(at: u32, block: mat4x4<f32>) {
    weight_gradients[at] = weight_gradients[at] + block;
}

// Biases are first columns. Sums of the outputs' gradients are those of the thread's quads, or of the one that thread 0 has read.
fn store_biases(first: u32, lane: u32, other: u32, own_sums: Own, other_sum: vec4<f32>) {
    if layer.first_bias == 0u || other > 0u {
        return;
    }
    if TAKES_INPUTS {
        if lane == 0u {
            weight_gradients[first + layer.first_bias][0] += other_sum;
        }
        return;
    }
    var sums = own_sums;
    for (var i = 0u; i < OWN_QUADS; i++) {
        let output = OWN_QUADS * lane + i;
        if output < layer.output_quads {
            weight_gradients[first + layer.first_bias + output][0] += sums[i];
        }
    }
}
