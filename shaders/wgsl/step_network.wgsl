// Sums the threads' gradients of the colour network and takes Adam's step; one thread a weight.

override WORKGROUP_SIZE: u32;

@group(0) @binding(0) var<uniform> params: TrainParams;
@group(0) @binding(1) var<storage, read> state: StepState;
@group(0) @binding(2) var<storage, read_write> weight_gradients: array<f32>;
@group(0) @binding(3) var<storage, read_write> moments: array<Moments>;
@group(0) @binding(4) var<storage, read_write> network: array<f32>;

@compute @workgroup_size(WORKGROUP_SIZE)
fn step_network(@builtin(global_invocation_id) id: vec3<u32>) {
    let count = arrayLength(&network);
    if id.x >= count {
        return;
    }
    var gradient = 0.0;
    for (var at = id.x; at < arrayLength(&weight_gradients); at += count) {
        gradient += weight_gradients[at];
        weight_gradients[at] = 0.0;
    }
    if state.diverged == 0u {
        let own = advanced(moments[id.x], gradient);
        moments[id.x] = own;
        network[id.x] += adam_step(own, params.network_rate);
    }
}
