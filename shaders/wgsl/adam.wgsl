// Adam's optimiser of one parameter.

// Decay of the means of gradients and of their squares.
override BETA_1: f32;
override BETA_2: f32;
override EPSILON: f32;

// A parameter's optimiser state.
struct Moments {
    mean: f32,
    square: f32,
}

fn advanced(before: Moments, gradient: f32) -> Moments {
    return Moments(
        before.mean + (1.0 - BETA_1) * (gradient - before.mean),
        before.square + (1.0 - BETA_2) * (gradient * gradient - before.square),
    );
}

// What the parameter moves by.
fn adam_step(moments: Moments, rate: f32) -> f32 {
    return -rate * moments.mean / (sqrt(moments.square) + EPSILON);
}
