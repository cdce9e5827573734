// Moves the sky's texels against their gradients, where there are any, and clears those; one thread a texel.

override WORKGROUP_SIZE: u32;

// Decay of the squared gradients' running mean.
override DECAY: f32;

@group(0) @binding(0) var<uniform> params: TrainParams;
@group(0) @binding(1) var<storage, read> state: StepState;
@group(0) @binding(2) var<storage, read_write> sky_gradients: array<f32>;
@group(0) @binding(3) var<storage, read_write> sky_squares: array<f32>;
@group(0) @binding(4) var<storage, read_write> sky_logits: array<f32>;

@compute @workgroup_size(WORKGROUP_SIZE)
fn step_sky(
    @builtin(global_invocation_id) id: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
) {
    for (var texel = id.x; texel < params.sky_texel_count; texel += groups.x * WORKGROUP_SIZE) {
        let at = 3u * texel;
        let gradient = vec3<f32>(sky_gradients[at], sky_gradients[at + 1u], sky_gradients[at + 2u]);
        let square = dot(gradient, gradient) / 3.0;
        if square != 0.0 {
            for (var c = 0u; c < 3u; c++) {
                sky_gradients[at + c] = 0.0;
            }
            if state.diverged == 0u {
                let mean = sky_squares[texel];
                let next = select(DECAY * mean + (1.0 - DECAY) * square, square, mean == 0.0);
                sky_squares[texel] = next;
                let step = params.sky_rate / sqrt(next) * gradient;
                sky_logits[at] -= step.x;
                sky_logits[at + 1u] -= step.y;
                sky_logits[at + 2u] -= step.z;
            }
        }
    }
}
