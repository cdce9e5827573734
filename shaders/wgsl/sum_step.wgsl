// Sums of a step's rays, and the range error from which the next step leaves rays out; one workgroup.

override WORKGROUP_SIZE: u32;

// Threads, at most.
const MAX_THREADS: u32 = 256u;
// Larger than every range error, so that nothing is left out.
const NO_TRIM_M: f32 = 3e38;

@group(0) @binding(0) var<uniform> params: TrainParams;
@group(0) @binding(1) var<storage, read> ray_losses: array<RayLoss>;
@group(0) @binding(2) var<storage, read> counters: array<u32>;
@group(0) @binding(3) var<storage, read_write> state: StepState;

var<workgroup> squared_errors: array<f32, MAX_THREADS>;
var<workgroup> losses: array<f32, MAX_THREADS>;
var<workgroup> color_rays: array<u32, MAX_THREADS>;
var<workgroup> range_rays: array<u32, MAX_THREADS>;
var<workgroup> trim_m: f32;

@compute @workgroup_size(WORKGROUP_SIZE)
fn sum_step(@builtin(local_invocation_index) thread: u32) {
    for (var ray = thread; ray < params.step_ray_count; ray += WORKGROUP_SIZE) {
        let own = ray_losses[ray];
        squared_errors[thread] += own.squared_error;
        losses[thread] += own.loss;
        color_rays[thread] += own.is_color;
        range_rays[thread] += u32(own.range_error_m >= 0.0);
    }
    if thread == 0u {
        trim_m = NO_TRIM_M;
    }
    workgroupBarrier();
    for (var half = WORKGROUP_SIZE / 2u; half > 0u; half /= 2u) {
        if thread < half {
            squared_errors[thread] += squared_errors[thread + half];
            losses[thread] += losses[thread + half];
            color_rays[thread] += color_rays[thread + half];
            range_rays[thread] += range_rays[thread + half];
        }
        workgroupBarrier();
    }
    if params.trim_quantile > 0.0 {
        find_trim(thread, u32(f32(range_rays[0]) * params.trim_quantile));
    }
    workgroupBarrier();
    if thread == 0u {
        write_state();
    }
}

// The error with `rank` smaller ones, found by the thread whose ray has it.
fn find_trim(thread: u32, rank: u32) {
    for (var ray = thread; ray < params.step_ray_count; ray += WORKGROUP_SIZE) {
        let error = ray_losses[ray].range_error_m;
        if error >= 0.0 {
            var below = 0u;
            var equal = 0u;
            for (var other = 0u; other < params.step_ray_count; other++) {
                let theirs = ray_losses[other].range_error_m;
                below += u32(theirs >= 0.0 && theirs < error);
                equal += u32(theirs == error);
            }
            if below <= rank && rank < below + equal {
                trim_m = error;
            }
        }
    }
}

fn write_state() {
    // What diverged is told as it was.
    if state.diverged != 0u {
        return;
    }
    state.squared_error = squared_errors[0];
    state.loss = losses[0];
    state.color_rays = color_rays[0];
    state.samples = counters[STEP_POINT_COUNT];
    state.colored = counters[STEP_COLORED_COUNT];
    state.depth_trim_m = trim_m;
    // Infinities and NaN have all exponent bits set; a comparison of floats may be assumed never to meet them.
    let is_finite = (bitcast<u32>(losses[0]) & 0x7f800000u) != 0x7f800000u;
    if !is_finite {
        state.diverged = 1u;
    }
    state.finite_steps += u32(is_finite);
}
