// Moves the corrections of views against their gradients and clears those; one workgroup.
//
// The mean over the views that had a ray is taken out of gradients and corrections: exposure and place of the field itself would take
// it up otherwise, and Adam would spend its whole step on it.

override WORKGROUP_SIZE: u32;
// Rotations move by the pose rate over this arm, metres.
override ARM_M: f32;

// Threads, at most.
const MAX_THREADS: u32 = 64u;
// Numbers that correct a view, in the order of its sums.
const VALUES: u32 = 12u;

@group(0) @binding(0) var<uniform> params: TrainParams;
@group(0) @binding(1) var<storage, read> state: StepState;
@group(0) @binding(2) var<storage, read_write> views: array<View>;
@group(0) @binding(3) var<storage, read_write> view_sums: array<u32>;
// VALUES a view.
@group(0) @binding(4) var<storage, read_write> moments: array<Moments>;

alias Values = array<f32, VALUES>;

var<workgroup> sums: array<Values, MAX_THREADS>;
var<workgroup> seen: array<f32, MAX_THREADS>;

@compute @workgroup_size(WORKGROUP_SIZE)
fn step_views(@builtin(local_invocation_index) thread: u32) {
    for (var view = thread; view < params.view_count; view += WORKGROUP_SIZE) {
        if view_sums[VIEW_SUMS * view + IS_SEEN] != 0u {
            seen[thread] += 1.0;
            collect(view, thread);
        }
    }
    workgroupBarrier();
    average(thread, true);
    for (var view = thread; view < params.view_count; view += WORKGROUP_SIZE) {
        if view_sums[VIEW_SUMS * view + IS_SEEN] != 0u && state.diverged == 0u {
            move_view(view);
        }
    }
    workgroupBarrier();
    sums[thread] = Values();
    for (var view = thread; view < params.view_count; view += WORKGROUP_SIZE) {
        if view_sums[VIEW_SUMS * view + IS_SEEN] != 0u {
            var own = values_of(view);
            for (var i = 0u; i < VALUES; i++) {
                sums[thread][i] += own[i];
            }
        }
    }
    workgroupBarrier();
    average(thread, false);
    for (var view = thread; view < params.view_count; view += WORKGROUP_SIZE) {
        if view_sums[VIEW_SUMS * view + IS_SEEN] != 0u {
            take_out_mean(view);
        }
        for (var i = 0u; i < VALUES; i++) {
            view_sums[VIEW_SUMS * view + i] = 0u;
        }
    }
}

// Leaves the mean of all threads' sums in those of the first, which also counts what was seen.
fn average(thread: u32, counts: bool) {
    if thread == 0u {
        for (var other = 1u; other < WORKGROUP_SIZE; other++) {
            if counts {
                seen[0] += seen[other];
            }
            for (var i = 0u; i < VALUES; i++) {
                sums[0][i] += sums[other][i];
            }
        }
        for (var i = 0u; i < VALUES; i++) {
            sums[0][i] /= max(seen[0], 1.0);
        }
    }
    workgroupBarrier();
}

// A view's corrections; the rotation as its scaled axis times the arm.
fn values_of(view: u32) -> Values {
    let own = views[view];
    let turn = scaled_axis(own.rotation) * ARM_M;
    return Values(
        own.log_gain.x, own.log_gain.y, own.log_gain.z,
        own.bias.x, own.bias.y, own.bias.z,
        turn.x, turn.y, turn.z,
        own.translation_m.x, own.translation_m.y, own.translation_m.z,
    );
}

// Completes a view's gradients and adds them to the thread's sums.
fn collect(view: u32, thread: u32) {
    var value = values_of(view);
    for (var i = 0u; i < VALUES; i++) {
        let at = VIEW_SUMS * view + i;
        var gradient = bitcast<f32>(view_sums[at]);
        if i >= BY_ROTATION && i < BY_TRANSLATION {
            gradient /= ARM_M;
        }
        gradient += select(params.pose_prior, params.exposure_prior, i < BY_ROTATION) * value[i];
        view_sums[at] = bitcast<u32>(gradient);
        sums[thread][i] += gradient;
    }
}

fn rate_of(i: u32) -> f32 {
    return select(params.pose_rate, params.exposure_rate, i < BY_ROTATION);
}

fn move_view(view: u32) {
    var step: Values;
    for (var i = 0u; i < VALUES; i++) {
        if rate_of(i) > 0.0 {
            let gradient = bitcast<f32>(view_sums[VIEW_SUMS * view + i]) - sums[0][i];
            let own = advanced(moments[VALUES * view + i], gradient);
            moments[VALUES * view + i] = own;
            step[i] = adam_step(own, rate_of(i));
        }
    }
    views[view].log_gain += vec4<f32>(step[0], step[1], step[2], 0.0);
    views[view].bias += vec4<f32>(step[3], step[4], step[5], 0.0);
    if params.pose_rate > 0.0 {
        let turn = from_scaled_axis(vec3<f32>(step[6], step[7], step[8]) / ARM_M);
        views[view].rotation = after(turn, views[view].rotation);
        views[view].translation_m += vec4<f32>(step[9], step[10], step[11], 0.0);
    }
}

fn take_out_mean(view: u32) {
    if params.exposure_rate > 0.0 {
        views[view].log_gain -= vec4<f32>(sums[0][0], sums[0][1], sums[0][2], 0.0);
        views[view].bias -= vec4<f32>(sums[0][3], sums[0][4], sums[0][5], 0.0);
    }
    if params.pose_rate > 0.0 {
        let back = from_scaled_axis(-vec3<f32>(sums[0][6], sums[0][7], sums[0][8]) / ARM_M);
        views[view].rotation = normalize(after(back, views[view].rotation));
        views[view].translation_m -= vec4<f32>(sums[0][9], sums[0][10], sums[0][11], 0.0);
    }
}
