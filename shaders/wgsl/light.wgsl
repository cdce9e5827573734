// Compositing intervals of constant density in optical depth.

struct Light {
    tau: f32,
    // Distance at which half of the light is gone; below 0 while more is left.
    half_t: f32,
}

// Weight of the interval near..far (metres along the ray) of density sigma (1/m).
fn absorb(light: ptr<function, Light>, sigma: f32, near: f32, far: f32) -> f32 {
    let step = sigma * (far - near);
    if (*light).half_t < 0.0 && (*light).tau + step >= scene.half_tau {
        (*light).half_t = near + (scene.half_tau - (*light).tau) / sigma;
    }
    let weight = exponential(-(*light).tau) * -exponential_less_one(-step);
    (*light).tau += step;
    return weight;
}

// A sample stands for the interval t - dt / 2 .. t + dt / 2.
fn start_of(sample: RaySample) -> f32 {
    return sample.t - 0.5 * sample.dt;
}

fn end_of(sample: RaySample) -> f32 {
    return sample.t + 0.5 * sample.dt;
}
