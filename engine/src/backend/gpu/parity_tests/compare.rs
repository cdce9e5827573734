//! Comparing what two sides computed. The sides have distinct types, so that comparing one with itself does not compile.

use crate::backend::{Marched, RaySummary};
use crate::field::RaySample;

/// A result of the device.
#[derive(Clone, Debug)]
pub(super) struct Gpu<T>(pub(super) T);

/// A result of the oracle.
#[derive(Clone, Debug)]
pub(super) struct Cpu<T>(pub(super) T);

/// `|gpu - cpu| <= absolute + relative * |cpu|`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Tolerance {
    pub(super) absolute: f32,
    pub(super) relative: f32,
}

/// Distances: leaving a cube is 1/x (2.5 ULP), a difference and a product, then up to 64 steps of half an ULP until the next
/// leap: 40 ULP of 16 m.
pub(super) const DISTANCE: Tolerance = Tolerance {
    absolute: 8e-5,
    relative: 0.0,
};
/// Densities at points that differ by [`DISTANCE`]: the raw density changes by at most 15 a metre here, the softplus by no more
/// than it, and 0.2 m of base voxel make that 75 a metre; exp and log add 10 ULP.
pub(super) const SIGMA: Tolerance = Tolerance {
    absolute: 6e-3,
    relative: 2e-6,
};
/// Optical depth: [`SIGMA`] over 16 m of samples, mostly of either sign: a quarter of it, and 256 additions.
pub(super) const TAU: Tolerance = Tolerance {
    absolute: 2e-4,
    relative: 3e-5,
};
/// A weight moves by no more than tau does, and so does their sum.
pub(super) const ACCUMULATION: Tolerance = Tolerance {
    absolute: 2e-4,
    relative: 0.0,
};
/// Accumulation's error at up to 16 m.
pub(super) const WEIGHTED_DISTANCE: Tolerance = Tolerance {
    absolute: 3e-3,
    relative: 0.0,
};

/// Largest deviations seen, for people.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Deviation {
    pub(super) distance_m: f32,
    pub(super) sigma: f32,
    pub(super) tau: f32,
    pub(super) accumulation: f32,
    pub(super) weighted_distance_m: f32,
}

/// Compares rays one by one: sample counts exactly, the rest within the tolerances.
///
/// # Errors
/// Names the first ray and quantity that differ.
pub(super) fn compare(gpu: &Gpu<Marched>, cpu: &Cpu<Marched>) -> Result<Deviation, String> {
    let (gpu, cpu) = (&gpu.0, &cpu.0);
    if gpu.summaries().len() != cpu.summaries().len() {
        return Err(format!(
            "{} rays against {}",
            gpu.summaries().len(),
            cpu.summaries().len()
        ));
    }
    let mut worst = Deviation::default();
    for ray in 0..gpu.summaries().len() {
        compare_summaries(&gpu.summaries()[ray], &cpu.summaries()[ray], &mut worst)
            .and_then(|()| compare_samples(gpu.samples(ray), cpu.samples(ray), &mut worst))
            .map_err(|what| format!("ray {ray}: {what}"))?;
    }
    Ok(worst)
}

fn compare_summaries(
    gpu: &RaySummary,
    cpu: &RaySummary,
    worst: &mut Deviation,
) -> Result<(), String> {
    if gpu.sample_count != cpu.sample_count {
        return Err(format!(
            "{} samples against {}",
            gpu.sample_count, cpu.sample_count
        ));
    }
    within("tau", gpu.tau, cpu.tau, TAU, &mut worst.tau)?;
    within(
        "accumulation",
        gpu.accumulation,
        cpu.accumulation,
        ACCUMULATION,
        &mut worst.accumulation,
    )?;
    let (gpu, cpu) = (gpu.weighted_distance_m, cpu.weighted_distance_m);
    within(
        "weighted distance",
        gpu,
        cpu,
        WEIGHTED_DISTANCE,
        &mut worst.weighted_distance_m,
    )
}

fn compare_samples(
    gpu: &[RaySample],
    cpu: &[RaySample],
    worst: &mut Deviation,
) -> Result<(), String> {
    for (gpu, cpu) in gpu.iter().zip(cpu) {
        within("t", gpu.t, cpu.t, DISTANCE, &mut worst.distance_m)?;
        within("dt", gpu.dt, cpu.dt, DISTANCE, &mut worst.distance_m)?;
        within("sigma", gpu.sigma, cpu.sigma, SIGMA, &mut worst.sigma)?;
    }
    Ok(())
}

fn within(
    what: &str,
    gpu: f32,
    cpu: f32,
    tolerance: Tolerance,
    worst: &mut f32,
) -> Result<(), String> {
    let deviation = (gpu - cpu).abs();
    let allowed = tolerance.absolute + tolerance.relative * cpu.abs();
    if deviation > allowed || deviation.is_nan() {
        return Err(format!("{what} {gpu} against {cpu}"));
    }
    *worst = worst.max(deviation);
    Ok(())
}
