// Angles in plain arithmetic: the built-in functions may be off by 2^-11, a tenth of a texel of the sky.

const PI: f32 = 3.1415927;

// Taylor's series, below 1e-8 from the sine in -1..1.
fn sine(x: vec3<f32>) -> vec3<f32> {
    let q = x * x;
    return x + x * q * (-1.0 / 6.0 + q * (1.0 / 120.0 + q * (-1.0 / 5040.0 + q * (1.0 / 362880.0 - q * (1.0 / 39916800.0)))));
}

// Taylor's series, below 1e-8 from the cosine in -1..1.
fn cosine(x: vec3<f32>) -> vec3<f32> {
    let q = x * x;
    return 1.0 + q * (-0.5 + q * (1.0 / 24.0 + q * (-1.0 / 720.0 + q * (1.0 / 40320.0 - q * (1.0 / 3628800.0)))));
}

// Angle of the vector (x, y) in -pi..pi.
fn arctangent(y: f32, x: f32) -> f32 {
    let low = min(abs(x), abs(y));
    let high = max(abs(x), abs(y));
    let ratio = select(0.0, low / high, high > 0.0);
    // Half the angle twice: tan(a / 2) = t / (1 + sqrt(1 + t^2)), below 0.2 after that, where the series is short.
    let half = ratio / (1.0 + sqrt(1.0 + ratio * ratio));
    let quarter = half / (1.0 + sqrt(1.0 + half * half));
    let q = quarter * quarter;
    let series = quarter - quarter * q * (1.0 / 3.0 - q * (1.0 / 5.0 - q * (1.0 / 7.0 - q * (1.0 / 9.0 - q * (1.0 / 11.0)))));
    var angle = 4.0 * series;
    if abs(y) > abs(x) {
        angle = 0.5 * PI - angle;
    }
    if x < 0.0 {
        angle = PI - angle;
    }
    return select(angle, -angle, y < 0.0);
}
