// Losses of one ray and their derivatives; the host's formulas are in the engine's `volume`.

// Below this optical depth the derivative of the opaque loss is held.
const TAU_MIN: f32 = 1e-2;
// Bounds of the probability inside the entropy.
const ENTROPY_MIN: f32 = 1e-6;

// A value and its derivative.
struct Loss {
    value: f32,
    slope: f32,
}

// Entropy of the remaining transmittance; only its derivative is wanted.
fn entropy_slope(transmittance: f32) -> f32 {
    let p = clamp(transmittance, ENTROPY_MIN, 1.0 - ENTROPY_MIN);
    return select(0.0, log(1.0 - p) - log(p), p == transmittance);
}

// -ln(1 - e^-tau), of a ray known to hit.
fn opaque_loss(tau: f32) -> Loss {
    let held = max(tau, TAU_MIN);
    let grown = exponential_less_one(held);
    return Loss(-log(-exponential_less_one(-held)) + (held - tau) / grown, -1.0 / grown);
}

// Huber of an error in metres, with slope 1 beyond the scale.
fn depth_error(error_m: f32, scale_m: f32) -> f32 {
    let size = abs(error_m);
    return select(size - 0.5 * scale_m, 0.5 * error_m * error_m / scale_m, size < scale_m);
}

// Coordinate of the distortion loss, t / (t + scale), and its derivative by t.
fn warped(t: f32, scale_m: f32) -> vec2<f32> {
    let sum = t + scale_m;
    return vec2<f32>(t / sum, scale_m / (sum * sum));
}
