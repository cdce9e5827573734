//! Comparing the stages of a training step.

use super::compare::{Cpu, Gpu};
use crate::backend::stages::{StageSample, Stages};

/// Distances in a box 2 m wide, 4 m away: 40 steps of half an ULP of 4 m, 2.4e-7 m each.
const DISTANCE_M: f32 = 1e-5;
/// Densities change by up to 20 / m / m here, over [`DISTANCE_M`].
const SIGMA: f32 = 4e-4;
/// A weight moves by its optical depth's error, [`SIGMA`] over steps of 0.06 m, forty times of either sign.
const WEIGHT: f32 = 3e-5;
/// Features change by up to 16 / m over [`DISTANCE_M`].
const FEATURE: f32 = 2e-4;
/// A colour is a quarter of its logit's error: twelve features through two layers whose rows' sums are near 1.
const COLOR: f32 = 1e-4;
/// Relative error of a whole gradient (root of summed squares): what its inputs are off, and activations whose sign rounding
/// flips. Measured 1e-5 to 1e-4 with the CPU's unfused path.
const GRADIENT: f64 = 5e-4;
/// Sums of losses in f32 against f64.
const SUM: f64 = 1e-4;

/// Largest deviations seen, for people.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct StageDeviation {
    pub(super) distance_m: f32,
    pub(super) sigma: f32,
    pub(super) weight: f32,
    pub(super) feature: f32,
    pub(super) color: f32,
    /// Relative, of the worst gradient.
    pub(super) gradient: f64,
}

/// Compares samples and what is coloured exactly, the rest within the tolerances.
///
/// # Errors
/// Names the first thing that differs.
pub(super) fn compare_stages(
    gpu: &Gpu<Stages>,
    cpu: &Cpu<Stages>,
) -> Result<StageDeviation, String> {
    let (gpu, cpu) = (&gpu.0, &cpu.0);
    same_shape(gpu, cpu)?;
    let mut worst = StageDeviation::default();
    for (number, (gpu, cpu)) in gpu.rays.iter().zip(&cpu.rays).enumerate() {
        compare_ray(gpu, cpu, &mut worst).map_err(|what| format!("ray {number}: {what}"))?;
    }
    let raw = |stages: &Stages| each(stages, |sample| vec![sample.raw]);
    gradient("raw density", &raw(gpu), &raw(cpu), &mut worst.gradient)?;
    let of_features = |stages: &Stages| {
        each(stages, |sample| {
            let colored = sample.colored.map(|c| c.feature_gradient.to_vec());
            colored.unwrap_or_default()
        })
    };
    gradient(
        "sample features",
        &of_features(gpu),
        &of_features(cpu),
        &mut worst.gradient,
    )?;
    gradient("network", &gpu.network, &cpu.network, &mut worst.gradient)?;
    gradient("sky", &gpu.sky, &cpu.sky, &mut worst.gradient)?;
    for (gpu, cpu) in gpu.density.iter().zip(&cpu.density) {
        gradient("density", gpu, cpu, &mut worst.gradient)?;
    }
    for (gpu, cpu) in gpu.features.iter().zip(&cpu.features) {
        gradient(
            "features",
            gpu.as_flattened(),
            cpu.as_flattened(),
            &mut worst.gradient,
        )?;
    }
    if !cpu.views.is_empty() {
        let exposures = |stages: &Stages| -> Vec<f32> {
            let views = stages.views.iter();
            views.flat_map(|view| view[..6].to_vec()).collect()
        };
        let poses = |stages: &Stages| -> Vec<f32> {
            let views = stages.views.iter();
            views.flat_map(|view| view[6..].to_vec()).collect()
        };
        gradient(
            "exposure",
            &exposures(gpu),
            &exposures(cpu),
            &mut worst.gradient,
        )?;
        gradient("pose", &poses(gpu), &poses(cpu), &mut worst.gradient)?;
    }
    if gpu.color_rays != cpu.color_rays {
        return Err(format!(
            "{} colour rays against {}",
            gpu.color_rays, cpu.color_rays
        ));
    }
    sum("squared error", gpu.squared_error, cpu.squared_error)?;
    sum("loss", gpu.loss, cpu.loss)?;
    Ok(worst)
}

/// Comparing in pairs leaves out what only one side has.
fn same_shape(gpu: &Stages, cpu: &Stages) -> Result<(), String> {
    let counts = |stages: &Stages| {
        [
            ("rays", stages.rays.len()),
            ("network weights", stages.network.len()),
            ("sky logits", stages.sky.len()),
            ("levels of density", stages.density.len()),
            ("levels of features", stages.features.len()),
            ("views", stages.views.len()),
        ]
    };
    for ((what, gpu), (_, cpu)) in counts(gpu).into_iter().zip(counts(cpu)) {
        if gpu != cpu {
            return Err(format!("{gpu} {what} against {cpu}"));
        }
    }
    Ok(())
}

fn each(stages: &Stages, of: impl Fn(&StageSample) -> Vec<f32>) -> Vec<f32> {
    stages.rays.iter().flatten().flat_map(of).collect()
}

fn compare_ray(
    gpu: &[StageSample],
    cpu: &[StageSample],
    worst: &mut StageDeviation,
) -> Result<(), String> {
    if gpu.len() != cpu.len() {
        return Err(format!("{} samples against {}", gpu.len(), cpu.len()));
    }
    for (g, c) in gpu.iter().zip(cpu) {
        within(
            "t",
            g.sample.t,
            c.sample.t,
            DISTANCE_M,
            &mut worst.distance_m,
        )?;
        within(
            "dt",
            g.sample.dt,
            c.sample.dt,
            DISTANCE_M,
            &mut worst.distance_m,
        )?;
        within(
            "sigma",
            g.sample.sigma,
            c.sample.sigma,
            SIGMA,
            &mut worst.sigma,
        )?;
        within("weight", g.weight, c.weight, WEIGHT, &mut worst.weight)?;
        match (&g.colored, &c.colored) {
            (None, None) => {}
            (Some(g), Some(c)) => {
                for (g, c) in g.features.iter().zip(c.features) {
                    within("feature", *g, c, FEATURE, &mut worst.feature)?;
                }
                for (g, c) in g.color.iter().zip(c.color) {
                    within("colour", *g, c, COLOR, &mut worst.color)?;
                }
            }
            (g, c) => {
                let (g, c) = (g.is_some(), c.is_some());
                return Err(format!(
                    "at {} m coloured: {g} against {c}",
                    cpu[0].sample.t
                ));
            }
        }
    }
    Ok(())
}

/// Takes note of the deviation of one value.
///
/// # Errors
/// Names what is off by more than `tolerance`.
pub(super) fn within(
    what: &str,
    gpu: f32,
    cpu: f32,
    tolerance: f32,
    worst: &mut f32,
) -> Result<(), String> {
    let deviation = (gpu - cpu).abs();
    if deviation > tolerance || deviation.is_nan() {
        return Err(format!("{what} {gpu} against {cpu}"));
    }
    *worst = worst.max(deviation);
    Ok(())
}

/// Takes note of the relative error of a whole gradient.
///
/// # Errors
/// Names the gradient that is off by more than [`GRADIENT`].
pub(super) fn gradient(
    what: &str,
    gpu: &[f32],
    cpu: &[f32],
    worst: &mut f64,
) -> Result<(), String> {
    let error = relative_error(gpu, cpu);
    if error > GRADIENT || error.is_nan() {
        return Err(format!("gradient by {what}: relative error {error:.2e}"));
    }
    *worst = worst.max(error);
    Ok(())
}

/// Root of the summed squares of the difference, relative to that of `cpu`.
pub(super) fn relative_error(gpu: &[f32], cpu: &[f32]) -> f64 {
    assert_eq!(gpu.len(), cpu.len(), "the same quantities");
    let norm = |values: &mut dyn Iterator<Item = f64>| values.map(|x| x * x).sum::<f64>().sqrt();
    let all = norm(&mut cpu.iter().map(|c| f64::from(*c)));
    assert!(all > 0.0, "nothing to compare with");
    let pairs = gpu.iter().zip(cpu);
    norm(&mut pairs.map(|(g, c)| f64::from(*g) - f64::from(*c))) / all
}

/// # Errors
/// Names the sum that is off by more than rounding.
pub(super) fn sum(what: &str, gpu: f64, cpu: f64) -> Result<(), String> {
    if (gpu - cpu).abs() <= SUM * cpu.abs() {
        Ok(())
    } else {
        Err(format!("{what} {gpu} against {cpu}"))
    }
}
