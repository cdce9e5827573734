// Adam's step of one kind of a dense grid's values, which clears their gradients; one workgroup a brick, as many times as it takes.

override WORKGROUP_SIZE: u32;
// 1: densities; 4: a quad of colour values.
override VALUES_PER_NODE: u32;

@group(0) @binding(0) var<uniform> params: GridParams;
@group(0) @binding(1) var<storage, read> state: StepState;
// 0: the brick stays. Else one more than the steps that it has rested for.
@group(0) @binding(2) var<storage, read> brick_turns: array<u32>;
// Factors on the density's rate, if there are any.
@group(0) @binding(3) var<storage, read> shares: array<f32>;
@group(0) @binding(4) var<storage, read_write> values: array<f32>;
@group(0) @binding(5) var<storage, read_write> gradients: array<f32>;
// Running means of gradients and of their squares.
@group(0) @binding(6) var<storage, read_write> means: array<f32>;
@group(0) @binding(7) var<storage, read_write> squares: array<f32>;

@compute @workgroup_size(WORKGROUP_SIZE)
fn step_grid(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(local_invocation_index) thread: u32,
    @builtin(num_workgroups) groups: vec3<u32>,
) {
    let moves = state.diverged == 0u;
    let count = NODES_PER_BRICK * VALUES_PER_NODE;
    for (var brick = params.first_brick + group.x; brick < params.brick_end; brick += groups.x) {
        let turn = brick_turns[brick];
        if turn == 0u {
            continue;
        }
        let decay = vec2<f32>(power(BETA_1, turn - 1u), power(BETA_2, turn - 1u));
        for (var within = thread; within < count; within += WORKGROUP_SIZE) {
            step_value(brick * count + within, decay, moves);
        }
    }
}

fn step_value(at: u32, decay: vec2<f32>, moves: bool) {
    let gradient = gradients[at];
    if gradient != 0.0 {
        gradients[at] = 0.0;
    }
    if !moves || (params.is_masked != 0u && gradient == 0.0) {
        return;
    }
    let own = advanced(Moments(means[at] * decay.x, squares[at] * decay.y), gradient);
    means[at] = own.mean;
    squares[at] = own.square;
    values[at] += adam_step(own, rate_of(at));
}

fn rate_of(at: u32) -> f32 {
    if VALUES_PER_NODE > 1u {
        return params.color_rate;
    }
    if params.has_shares != 0u {
        return params.density_rate * shares[at];
    }
    return params.density_rate;
}

// A whole power by squaring: the built-in one differs from device to device.
fn power(base: f32, exponent: u32) -> f32 {
    var result = 1.0;
    var factor = base;
    for (var left = exponent; left > 0u; left >>= 1u) {
        if (left & 1u) != 0u {
            result *= factor;
        }
        factor *= factor;
    }
    return result;
}
