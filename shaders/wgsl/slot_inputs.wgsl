// The colour network's inputs of four slots.

// Slots past the last repeat it, so that all threads take the same way.
fn inputs_of_slots(first: u32, last: u32, inputs: ptr<function, Inputs>) {
    set_slot(inputs, 0u, first);
    set_slot(inputs, 1u, min(first + 1u, last));
    set_slot(inputs, 2u, min(first + 2u, last));
    set_slot(inputs, 3u, min(first + 3u, last));
}

fn set_slot(inputs: ptr<function, Inputs>, s: u32, slot: u32) {
    (*inputs)[0][s] = slot_features[3u * slot];
    (*inputs)[1][s] = slot_features[3u * slot + 1u];
    (*inputs)[2][s] = slot_features[3u * slot + 2u];
    set_view(inputs, s, rays[slot_samples[slot].ray].direction);
}
