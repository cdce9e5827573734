//! The training loop, the same for every kind of field.

use super::average::Average;
use super::control::{Progress, Stage, TrainControl};
use super::evaluate::evaluate;
use super::input::Trained;
use super::preset::TrainPreset;
use super::ray::{Rates, TrainRay};
use super::refine::{Urgency, refine};
use super::sampler::{RayMix, Sampler};
use crate::backend::Backend;
use crate::field::Field;
use crate::quality::psnr_db;
use crate::view::TrainView;
use crate::{Error, Result};

/// Weight of the newest step in the running training error.
const ERROR_MOMENTUM: f64 = 0.05;

/// What a run was.
#[derive(Clone, Debug, Default)]
pub(super) struct Run {
    pub(super) steps: u64,
    pub(super) rays: u64,
    pub(super) seconds: f64,
    pub(super) psnr_train: Option<f64>,
    pub(super) warnings: Vec<String>,
}

/// Fits `field` and returns it. `urgency(position, level)` says where a level may store bricks.
pub(super) fn fit(
    field: Field,
    sampler: &Sampler<'_>,
    preset: &TrainPreset,
    urgency: Urgency<'_>,
    backend: &dyn Backend,
    control: &dyn TrainControl,
) -> Result<(Field, Run)> {
    let cancelled = || control.cancelled();
    let mut trainer = backend.trainer(field, &cancelled)?;
    let mut run = Run::default();
    let mut rays: Vec<TrainRay> = Vec::new();
    let mut losses = preset.losses;
    let mut surveyed = 0;
    let mut average = Average::of_last(preset.options.average_last);
    let mut pixel_rays = preset.mix.pixel_rays;
    let mut error = None;
    let start_s = control.seconds();
    let steps = step_count(preset, sampler.pixel_count());
    run.steps = steps;
    for step in 0..steps {
        if cancelled() {
            return Err(Error::Cancelled);
        }
        let seconds = control.seconds() - start_s;
        let clock = if preset.seconds > 0.0 {
            seconds / preset.seconds
        } else {
            0.0
        };
        let done = (step as f64 / steps as f64).max(clock);
        if done >= 1.0 {
            break;
        }
        if preset.surveys.due(step, done) > surveyed {
            surveyed += 1;
            average.restart();
            run.warnings
                .extend(refine(&mut trainer, preset, urgency, &cancelled)?);
        }
        let mix = RayMix {
            pixel_rays,
            solid_teaches_sky: done >= preset.solid_sky_from,
            ..preset.mix
        };
        losses.min_weight = preset
            .options
            .min_weight(done)
            .unwrap_or(preset.losses.min_weight);
        sampler.draw(step, &mix, &mut rays);
        let passes = run.rays as f64 / sampler.pixel_count() as f64;
        let rates = rates_at(preset, done, passes);
        let report = trainer.step(&rays, &losses, rates, &cancelled)?;
        run.rays += rays.len() as u64;
        if let Some(report) = report {
            if report.color_rays > 0 {
                let now = report.squared_error / report.color_rays as f64;
                error = Some(error.map_or(now, |e| e + ERROR_MOMENTUM * (now - e)));
            }
            pixel_rays = affordable_rays(preset, report.colored, rays.len() as u64);
        }
        if average.is_due(done) {
            trainer.fetch(&cancelled)?;
            average.add(trainer.field());
        }
        let progress = Progress {
            stage: Stage::Train,
            step: step + 1,
            step_count: steps,
            psnr_train: error.map(psnr_db),
        };
        control.progress(progress);
        if control.looks(progress) {
            trainer.fetch(&cancelled)?;
            control.inspect(progress, trainer.field());
        }
    }
    if let Some(mean) = average.mean() {
        trainer.fetch(&cancelled)?;
        mean.replace(trainer.field_mut());
    }
    run.warnings
        .extend(refine(&mut trainer, preset, &|_, _| None, &cancelled)?);
    run.seconds = control.seconds() - start_s;
    run.psnr_train = error.map(psnr_db);
    let field = trainer.into_field(&cancelled)?;
    if let Some(quantity) = not_finite(&field) {
        return Err(Error::Diverged {
            step: steps,
            quantity,
        });
    }
    Ok((field, run))
}

/// The parameters of a field that are not all finite, if any: a loss may stay finite beside a voxel that no ray weighs.
fn not_finite(field: &Field) -> Option<&'static str> {
    let finite = |values: &[f32]| values.iter().all(|x| x.is_finite());
    let densities = field.levels.iter().all(|level| finite(level.density()));
    let mut features = field.levels.iter().map(|level| level.features());
    if !densities {
        return Some("density");
    }
    if !features.all(|features| finite(features.as_flattened())) {
        return Some("features");
    }
    (!finite(field.mlp.parameters())).then_some("colour network")
}

/// The fitted field with its figures on the held-out views.
pub(super) fn measured(
    field: Field,
    run: Run,
    views: &[TrainView],
    backdrop: Option<[f32; 3]>,
    control: &dyn TrainControl,
) -> Trained {
    control.progress(Progress {
        stage: Stage::Evaluate,
        step: run.steps,
        step_count: run.steps,
        psnr_train: run.psnr_train,
    });
    let quality = evaluate(&field, views, run, backdrop);
    Trained { field, quality }
}

/// Below this even the learning rates have no time to act.
const LEAST_STEPS: f64 = 100.0;

fn step_count(preset: &TrainPreset, pixels: u64) -> u64 {
    let enough = preset.most_passes * pixels as f64 / preset.mix.pixel_rays as f64;
    preset.steps.min(enough.max(LEAST_STEPS).ceil() as u64)
}

/// Fewer rays than this are too noisy a step.
const LEAST_RAYS: u64 = 512;

/// Rays of the next step, from the coloured samples of the last.
fn affordable_rays(preset: &TrainPreset, colored: u64, rays: u64) -> usize {
    let most = preset.mix.pixel_rays as u64;
    let rays = (preset.most_colored.saturating_mul(rays) / colored.max(1)).max(LEAST_RAYS);
    rays.min(most) as usize
}

/// How the rates fall with the passes beyond [`TrainPreset::settle_passes`]: between the -1/2 that keeps moving and the -1 that
/// averages noise away best but cannot follow.
const SETTLE_POWER: f64 = -0.75;

/// What is left of the sky map's rate at the end, whatever of the others': its texels show the noise of every step, over a part of
/// the image that has none itself.
const SKY_DECAY: f32 = 0.1;

/// Exponential decay, as DVGO's, times the settling.
fn rates_at(preset: &TrainPreset, done: f64, passes: f64) -> Rates {
    let settled = (1.0 + passes / preset.settle_passes).powf(SETTLE_POWER) as f32;
    let factor = preset.rate_decay.powf(done as f32) * settled;
    let mut rates = preset.rates.scaled(factor);
    rates.sky = preset.rates.sky * SKY_DECAY.powf(done as f32) * settled;
    if done < preset.options.poses_from {
        rates.pose_m = 0.0;
    }
    rates
}

#[cfg(test)]
mod tests {
    use super::super::preset::Budget;
    use super::*;

    #[test]
    fn rates_settle_with_the_passes_and_decay_with_the_run() {
        let preset = TrainPreset::fast(2.0, 0.02);
        let at = |done, passes| rates_at(&preset, done, passes).density;
        assert_eq!(at(0.0, 0.0), preset.rates.density);
        let halfway = at(0.0, preset.settle_passes) / preset.rates.density;
        assert!((halfway - 0.5f32.powf(0.75)).abs() < 1e-6, "{halfway}");
        assert!((at(1.0, 0.0) / preset.rates.density - preset.rate_decay).abs() < 1e-6);
        let constant = TrainPreset {
            rate_decay: 1.0,
            settle_passes: f64::INFINITY,
            ..TrainPreset::background(Budget::Standard)
        };
        let (first, last) = (constant.rates, rates_at(&constant, 1.0, 0.0));
        assert_eq!(last.features, first.features);
        assert!((last.sky / first.sky - SKY_DECAY).abs() < 1e-6);
        let never = TrainPreset {
            settle_passes: f64::INFINITY,
            ..preset
        };
        assert_eq!(rates_at(&never, 0.0, 1e6).density, never.rates.density);
    }

    #[test]
    fn steps_take_as_many_rays_as_their_colours_allow() {
        let mut preset = TrainPreset::fast(2.0, 0.02);
        preset.mix.pixel_rays = 4_096;
        preset.most_colored = 10_000;
        let rays = |colored, rays| affordable_rays(&preset, colored, rays);
        // Ten colours a ray: a thousand rays.
        assert_eq!(rays(20_000, 2_000), 1_000);
        assert_eq!(rays(0, 2_000), 4_096);
        assert_eq!(rays(u64::MAX, 2_000), LEAST_RAYS as usize);
    }

    #[test]
    fn surveys_are_due_by_steps_or_by_fractions() {
        use super::super::preset::Surveys;
        let steps = Surveys::AtSteps(vec![10, 20]);
        assert_eq!(
            (steps.due(9, 1.0), steps.due(10, 0.0), steps.due(25, 0.0)),
            (0, 1, 2)
        );
        let fractions = Surveys::AtFractions(vec![0.1, 0.5]);
        assert_eq!((fractions.due(1_000, 0.0), fractions.due(0, 0.5)), (0, 2));
    }
}
