//! Rays, shapes and rates as the kernels take them.

use backlot_shaders::{grid_layout, layout};

use crate::backend::gpu::train::rays::adam_rate;
use crate::train::dvgo::{PixelRay, STOP_TAU, Stage, bias_correction};

/// Learning rates of a step, bias corrections included.
#[derive(Clone, Copy, Debug)]
pub(super) struct StepRates {
    density: f32,
    color: f32,
    network: f32,
    /// Of this optimiser, counted from 1.
    step: u32,
}

impl StepRates {
    /// Of the stage's next step.
    pub(super) fn of<const C: usize>(stage: &Stage<C>) -> Self {
        let rates = stage.rates();
        let step = stage.age as u32 + 1;
        let correction = bias_correction(step);
        Self {
            density: (rates.density * correction) as f32,
            color: (rates.color * correction) as f32,
            network: adam_rate(rates.mlp as f32, stage.age + 1),
            step,
        }
    }
}

/// A ray with what it is compared with.
pub(super) fn pixel_ray(ray: &PixelRay) -> grid_layout::PixelRay {
    grid_layout::PixelRay {
        origin_m: ray.ray.origin.to_array(),
        near_m: ray.near_m,
        direction: ray.ray.direction.to_array(),
        stop_tau: STOP_TAU,
        color: ray.color,
        padding: 0,
    }
}

/// Parameters of a step without the batch's.
pub(super) fn batch_params<const C: usize>(
    stage: &Stage<C>,
    rates: StepRates,
    samples_per_ray: u32,
) -> grid_layout::GridParams {
    let (shape, medium, losses) = (&stage.shape, stage.medium(), stage.losses);
    grid_layout::GridParams {
        nodes: shape.nodes.to_array(),
        bricks: shape.bricks.to_array(),
        low_m: shape.low.as_vec3().to_array(),
        step_m: medium.step_m,
        high_m: shape.high.as_vec3().to_array(),
        sample_capacity: samples_per_ray,
        nodes_per_m: shape.spacing_m().as_vec3().recip().to_array(),
        act_shift: medium.shift,
        backdrop: losses.backdrop,
        interval: medium.interval,
        raw_min: medium.raw_min,
        weight_min: stage.grid.alpha_min as f32,
        ray_share: losses.ray_share,
        entropy: losses.entropy,
        sample_color: losses.sample_color,
        density_rate: rates.density,
        color_rate: rates.color,
        step: rates.step,
        is_masked: u32::from(stage.recipe.masked),
        ..grid_layout::GridParams::default()
    }
}

/// What the kernels read that sum a step's losses and move the network.
pub(super) fn train_params(rates: StepRates, rays: usize) -> layout::TrainParams {
    layout::TrainParams {
        step_ray_count: rays as u32,
        network_rate: rates.network,
        ..layout::TrainParams::default()
    }
}
