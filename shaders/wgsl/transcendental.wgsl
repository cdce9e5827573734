// Exponentials in plain arithmetic, the same as the engine's own on the host: the built-in ones differ from device to device.

// Beyond this e^x leaves the normal f32 numbers.
const EXPONENT_MAX: f32 = 87.0;

// 2^n and e^r - 1 with x = n ln 2 + r and |r| <= ln 2 / 2.
fn split_exponent(x: f32) -> vec2<f32> {
    let held = clamp(x, -EXPONENT_MAX, EXPONENT_MAX);
    let n = round(held * 1.442695);
    // ln 2 in two parts: whole multiples of the first are exact (Cody and Waite).
    let r = (held - n * 0.6933594) + n * 2.1219444e-4;
    let power = bitcast<f32>(u32(i32(n) + 127) << 23u);
    // Taylor's series to the seventh power.
    var p = 1.0 / 5040.0;
    p = p * r + 1.0 / 720.0;
    p = p * r + 1.0 / 120.0;
    p = p * r + 1.0 / 24.0;
    p = p * r + 1.0 / 6.0;
    p = p * r + 0.5;
    return vec2<f32>(power, p * r * r + r);
}

// e^x; x is held within +-87.
fn exponential(x: f32) -> f32 {
    let parts = split_exponent(x);
    return parts.x * parts.y + parts.x;
}

// e^x - 1; x is held within +-87.
fn exponential_less_one(x: f32) -> f32 {
    let parts = split_exponent(x);
    return parts.x * parts.y + (parts.x - 1.0);
}

// ln(1 + y) for y in 0..=1.
fn log_one_plus(y: f32) -> f32 {
    // 2 artanh(s), s = y / (2 + y) <= 1/3.
    let s = y / (2.0 + y);
    let q = s * s;
    var p = 1.0 / 13.0;
    p = p * q + 1.0 / 11.0;
    p = p * q + 1.0 / 9.0;
    p = p * q + 1.0 / 7.0;
    p = p * q + 1.0 / 5.0;
    p = p * q + 1.0 / 3.0;
    return 2.0 * s + 2.0 * s * q * p;
}

// ln(1 + e^x) without overflow.
fn softplus(x: f32) -> f32 {
    return max(x, 0.0) + log_one_plus(exponential(-abs(x)));
}

// 1 / (1 + e^-x) without overflow.
fn sigmoid(x: f32) -> f32 {
    let e = exponential(-abs(x));
    return select(e, 1.0, x >= 0.0) / (1.0 + e);
}
