// Adds to what a view sums.

// WGSL has no addition of floats to shared memory: repeats the sum until no other thread came between.
fn add_to_view(at: u32, value: f32) {
    var old = atomicLoad(&view_sums[at]);
    loop {
        let result = atomicCompareExchangeWeak(&view_sums[at], old, bitcast<u32>(bitcast<f32>(old) + value));
        if result.exchanged {
            break;
        }
        old = result.old_value;
    }
}
