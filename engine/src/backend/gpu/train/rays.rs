//! Rays, losses and rates as the kernels take them.

use backlot_shaders::layout;

use crate::backend::cpu::adam::{BETA1, BETA2};
use crate::field::Field;
use crate::train::ray::{Backdrop, DepthForm, Rates, RayLosses, Rectified, Silhouette, TrainRay};

/// Optical depth at which a ray ends: transmittance 1e-3, as in DVGO.
const STOP_TAU: f32 = 6.9;

/// What is marched.
pub(super) fn march_ray(ray: &TrainRay) -> layout::Ray {
    layout::Ray {
        origin_m: ray.ray.origin.to_array(),
        t_min: 0.0,
        direction: ray.ray.direction.to_array(),
        t_max: ray.t_max.min(f32::MAX),
        stop_tau: STOP_TAU,
        phase: ray.phase,
        padding: [0; 2],
    }
}

/// What it is compared with.
pub(super) fn target(ray: &TrainRay) -> layout::RayTarget {
    let (backdrop_kind, backdrop) = match ray.backdrop {
        Backdrop::Sky => (0, [0.0; 3]),
        Backdrop::SkyAsIs => (1, [0.0; 3]),
        Backdrop::Color(color) => (2, color),
    };
    layout::RayTarget {
        color: ray.color,
        color_weight: ray.color_weight,
        backdrop,
        silhouette_weight: ray.silhouette_weight,
        range_m: ray.range_m,
        range_weight: ray.range_weight,
        backdrop_kind,
        silhouette: match ray.silhouette {
            Silhouette::Unknown => 0,
            Silhouette::Opaque => 1,
            Silhouette::Transparent => 2,
        },
        view: ray.view,
        mirrored: u32::from(ray.mirrored),
        padding: [0; 2],
    }
}

/// Adam's rate with its bias corrections, in the `taken`-th step.
pub(in crate::backend::gpu) fn adam_rate(rate: f32, taken: u64) -> f32 {
    let taken = i32::try_from(taken).unwrap_or(i32::MAX);
    rate * (1.0 - BETA2.powi(taken)).sqrt() / (1.0 - BETA1.powi(taken))
}

/// Parameters of a step without the batch's.
pub(super) fn step_params(
    field: &Field,
    losses: &RayLosses,
    rates: Rates,
    step: u64,
) -> layout::TrainParams {
    let grids = field.sky.as_ref().map_or(&[][..], |sky| sky.grids());
    layout::TrainParams {
        base_voxel_m: field.activation.base_voxel_m,
        level_count: field.levels.len() as u32,
        sky_grid_count: grids.len() as u32,
        step: step as u32,
        min_weight: losses.min_weight,
        sample_color: losses.sample_color,
        entropy: losses.entropy,
        depth_scale_m: losses.depth_scale_m,
        depth_cap_m: losses.depth_cap_m,
        depth_trim_m: losses.depth_trim_m.min(f32::MAX),
        depth_is_composited: u32::from(losses.depth == DepthForm::CompositedL1),
        rectified_is_printed: u32::from(losses.rectified == Rectified::Printed),
        distortion: losses.distortion,
        distortion_scale_m: losses.distortion_scale_m,
        density_rate: rates.density,
        feature_rate: rates.features,
        network_rate: adam_rate(rates.mlp, step + 1),
        sky_rate: rates.sky,
        density_variation_rate: rates.density * losses.density_variation,
        feature_variation_rate: rates.features * losses.feature_variation,
        sky_texel_count: grids.iter().map(|grid| grid.logits().len() as u32).sum(),
        ..layout::TrainParams::default()
    }
}
