//! Comparing the stages of a step on a dense grid.

use super::compare::{Cpu, Gpu};
use super::stage_compare::{gradient, sum, within};
use crate::train::dvgo::record::{GridStages, RayStage, SampleStage};

/// Node coordinates up to 28: an ULP of them, and five operations with half an ULP each on the way.
const NODES: f32 = 1e-5;
/// Raw densities differ by up to 11 a node here and [`NODES`] moves them by 1e-4; the softplus changes by no more, over 0.5 voxels.
const TAU: f32 = 1e-4;
/// A weight moves by its optical depth's error, and by those before it, forty times of either sign.
const WEIGHT: f32 = 3e-4;
/// A colour is a quarter of its logit's error; colour values change by up to 2 a node over [`NODES`], in twelve through two layers.
const COLOR: f32 = 1e-4;

/// Largest deviations seen, for people.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct GridDeviation {
    nodes: f32,
    tau: f32,
    weight: f32,
    color: f32,
    /// Relative, of the worst gradient.
    gradient: f64,
}

/// Compares samples and what is coloured exactly in number, the rest within the tolerances.
///
/// # Errors
/// Names the first thing that differs.
pub(super) fn compare_grids<const C: usize>(
    gpu: &Gpu<GridStages<C>>,
    cpu: &Cpu<GridStages<C>>,
) -> Result<GridDeviation, String> {
    let (gpu, cpu) = (&gpu.0, &cpu.0);
    if gpu.rays.len() != cpu.rays.len() {
        return Err(format!(
            "{} rays against {}",
            gpu.rays.len(),
            cpu.rays.len()
        ));
    }
    let mut worst = GridDeviation::default();
    for (number, (gpu, cpu)) in gpu.rays.iter().zip(&cpu.rays).enumerate() {
        compare_ray(gpu, cpu, &mut worst).map_err(|what| format!("ray {number}: {what}"))?;
    }
    let mut gradient = |what: &str, of: fn(&GridStages<C>) -> Vec<f32>| {
        let (gpu, cpu) = (of(gpu), of(cpu));
        match gpu.is_empty() && cpu.is_empty() {
            true => Ok(()),
            false => gradient(what, &gpu, &cpu, &mut worst.gradient),
        }
    };
    gradient("raw density", |stages| {
        samples(stages).map(|s| s.raw).collect()
    })?;
    gradient("sample colour values", |stages| {
        let rows = samples(stages).filter_map(|s| s.shown);
        rows.flat_map(|(_, row)| row).collect()
    })?;
    gradient("density", |stages| stages.density.clone())?;
    gradient("colour values", |stages| {
        stages.colors.as_flattened().to_vec()
    })?;
    gradient("network", |stages| stages.network.clone())?;
    sum("squared error", gpu.squared_error, cpu.squared_error)?;
    sum("loss", gpu.loss, cpu.loss)?;
    Ok(worst)
}

fn samples<const C: usize>(stages: &GridStages<C>) -> impl Iterator<Item = &SampleStage<C>> {
    stages.rays.iter().flat_map(|ray| &ray.samples)
}

fn compare_ray<const C: usize>(
    gpu: &RayStage<C>,
    cpu: &RayStage<C>,
    worst: &mut GridDeviation,
) -> Result<(), String> {
    let (count, expected) = (gpu.samples.len(), cpu.samples.len());
    if count != expected {
        return Err(format!("{count} samples against {expected}"));
    }
    within("light left", gpu.left, cpu.left, WEIGHT, &mut worst.weight)?;
    for (number, (g, c)) in gpu.samples.iter().zip(&cpu.samples).enumerate() {
        for axis in 0..3 {
            within("place", g.q[axis], c.q[axis], NODES, &mut worst.nodes)?;
        }
        within("optical depth", g.tau, c.tau, TAU, &mut worst.tau)?;
        within("slope", g.slope, c.slope, TAU, &mut worst.tau)?;
        within("weight", g.weight, c.weight, WEIGHT, &mut worst.weight)?;
        match (&g.shown, &c.shown) {
            (None, None) => {}
            (Some((g, _)), Some((c, _))) => {
                for (g, c) in g.iter().zip(c) {
                    within("colour", *g, *c, COLOR, &mut worst.color)?;
                }
            }
            (g, c) => {
                let (g, c) = (g.is_some(), c.is_some());
                return Err(format!("sample {number} coloured: {g} against {c}"));
            }
        }
    }
    Ok(())
}
