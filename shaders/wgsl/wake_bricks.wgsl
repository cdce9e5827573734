// Decides which bricks of a dense grid move in a step; one thread a brick.

override WORKGROUP_SIZE: u32;
// Where every value moves at every step, one without gradient for this many steps rests.
override LIVELY_STEPS: u32;

@group(0) @binding(0) var<uniform> params: GridParams;
// Step of a brick's last gradient; 0 for none.
@group(0) @binding(1) var<storage, read> brick_seen: array<u32>;
// Step of its last move.
@group(0) @binding(2) var<storage, read_write> brick_moved: array<u32>;
// 0: it stays. Else one more than the steps that it has rested for, by which its moments decay first.
@group(0) @binding(3) var<storage, read_write> brick_turns: array<u32>;

@compute @workgroup_size(WORKGROUP_SIZE)
fn wake_bricks(@builtin(global_invocation_id) id: vec3<u32>) {
    let brick = id.x;
    if brick >= params.brick_end {
        return;
    }
    let seen = brick_seen[brick];
    var turn = 0u;
    if params.is_masked != 0u {
        // Moments of what has no gradient stand still.
        turn = u32(seen == params.step);
    } else if seen != 0u && params.step - seen <= LIVELY_STEPS {
        turn = params.step - brick_moved[brick];
        brick_moved[brick] = params.step;
    }
    brick_turns[brick] = turn;
}
