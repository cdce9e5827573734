// Adding to the gradients of nodes, which the kernel binds by these names.
// WGSL has no addition of floats to shared memory; each of these repeats its sum until no other thread came between.

fn add_to_density(at: u32, value: f32) {
    var old = atomicLoad(&density_gradients[at]);
    loop {
        let result = atomicCompareExchangeWeak(&density_gradients[at], old, bitcast<u32>(bitcast<f32>(old) + value));
        if result.exchanged {
            break;
        }
        old = result.old_value;
    }
}

fn add_to_a(at: u32, value: f32) {
    var old = atomicLoad(&gradients_a[at]);
    loop {
        let result = atomicCompareExchangeWeak(&gradients_a[at], old, bitcast<u32>(bitcast<f32>(old) + value));
        if result.exchanged {
            break;
        }
        old = result.old_value;
    }
}

fn add_to_b(at: u32, value: f32) {
    var old = atomicLoad(&gradients_b[at]);
    loop {
        let result = atomicCompareExchangeWeak(&gradients_b[at], old, bitcast<u32>(bitcast<f32>(old) + value));
        if result.exchanged {
            break;
        }
        old = result.old_value;
    }
}

fn add_to_c(at: u32, value: f32) {
    var old = atomicLoad(&gradients_c[at]);
    loop {
        let result = atomicCompareExchangeWeak(&gradients_c[at], old, bitcast<u32>(bitcast<f32>(old) + value));
        if result.exchanged {
            break;
        }
        old = result.old_value;
    }
}
