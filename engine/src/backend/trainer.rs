//! Training on either backend.

use super::cpu::CpuTrainer;
#[cfg(feature = "gpu")]
use super::gpu::GpuTrainer;
use crate::field::Field;
use crate::train::ray::{Rates, RayLosses, TrainRay};
use crate::{Error, Result};

/// Depth rays whose error exceeds this quantile of the previous step's are outliers.
const DEPTH_TRIM_QUANTILE: f64 = 0.95;

/// A field in training, with its optimiser state.
#[derive(Debug)]
pub struct Trainer {
    on: On,
    steps: u64,
    /// Range errors above this are outliers, once a step has said so.
    depth_trim_m: Option<f32>,
}

#[derive(Debug)]
enum On {
    Cpu(Box<CpuTrainer>),
    #[cfg(feature = "gpu")]
    Gpu(Box<GpuTrainer>),
}

/// What is known about a step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StepReport {
    pub color_rays: u64,
    /// Sum of the colour rays' mean squared errors.
    pub squared_error: f64,
    /// Coloured samples.
    pub colored: u64,
}

impl Trainer {
    pub fn on_cpu(trainer: CpuTrainer) -> Self {
        Self::new(On::Cpu(Box::new(trainer)))
    }

    #[cfg(feature = "gpu")]
    pub fn on_gpu(trainer: GpuTrainer) -> Self {
        Self::new(On::Gpu(Box::new(trainer)))
    }

    fn new(on: On) -> Self {
        Self {
            on,
            steps: 0,
            depth_trim_m: None,
        }
    }

    /// Takes one optimiser step on `rays`. Rays whose range error was among the worst twentieth of the step before are left out; the
    /// first step leaves out those above [`RayLosses::depth_trim_m`].
    ///
    /// A GPU reports on some steps only, and works on the last one while the next is drawn. `cancelled` is asked now and then.
    ///
    /// # Errors
    /// [`Error::Diverged`], [`Error::Cancelled`], or the device's.
    pub fn step(
        &mut self,
        rays: &[TrainRay],
        losses: &RayLosses,
        rates: Rates,
        cancelled: &dyn Fn() -> bool,
    ) -> Result<Option<StepReport>> {
        let step = self.steps;
        self.steps += 1;
        match &mut self.on {
            On::Cpu(trainer) => {
                if cancelled() {
                    return Err(Error::Cancelled);
                }
                let losses = RayLosses {
                    depth_trim_m: self.depth_trim_m.unwrap_or(losses.depth_trim_m),
                    ..*losses
                };
                let sums = trainer.step(rays, &losses, rates);
                self.depth_trim_m = Some(quantile(&sums.range_errors_m, DEPTH_TRIM_QUANTILE));
                let (color, loss) = (sums.squared_error, sums.loss);
                if let Some(quantity) = not_finite(color, loss) {
                    return Err(Error::Diverged { step, quantity });
                }
                Ok(Some(StepReport {
                    color_rays: sums.color_rays,
                    squared_error: sums.squared_error,
                    colored: sums.colored,
                }))
            }
            #[cfg(feature = "gpu")]
            On::Gpu(trainer) => {
                trainer.step(rays, losses, rates, DEPTH_TRIM_QUANTILE, cancelled)?;
                if is_reported(step) {
                    report(trainer).map(Some)
                } else {
                    Ok(None)
                }
            }
        }
    }

    /// The field: on a GPU as of the last [`Self::fetch`].
    pub fn field(&self) -> &Field {
        match &self.on {
            On::Cpu(trainer) => trainer.field(),
            #[cfg(feature = "gpu")]
            On::Gpu(trainer) => trainer.field(),
        }
    }

    /// Brings [`Self::field`] up to date. Costs nothing on the CPU; `cancelled` is asked between pieces of what comes from a GPU.
    ///
    /// # Errors
    /// [`Error::Cancelled`], or the device's.
    pub fn fetch(&mut self, cancelled: &dyn Fn() -> bool) -> Result<()> {
        match &mut self.on {
            On::Cpu(_) => {
                let _ = cancelled;
                Ok(())
            }
            #[cfg(feature = "gpu")]
            On::Gpu(trainer) => Ok(trainer.fetch(cancelled)?),
        }
    }

    /// Changes the occupancy or adds bricks between steps, after [`Self::fetch`]. Removing bricks is [`Self::retain_bricks`].
    pub fn field_mut(&mut self) -> &mut Field {
        match &mut self.on {
            On::Cpu(trainer) => trainer.field_mut(),
            #[cfg(feature = "gpu")]
            On::Gpu(trainer) => trainer.field_mut(),
        }
    }

    /// Drops the bricks of a level for which `keep` does not hold, with their optimiser state, after [`Self::fetch`].
    pub fn retain_bricks(&mut self, level: usize, keep: impl Fn(u32) -> bool) {
        match &mut self.on {
            On::Cpu(trainer) => trainer.retain_bricks(level, keep),
            #[cfg(feature = "gpu")]
            On::Gpu(trainer) => trainer.retain_bricks(level, keep),
        }
    }

    /// The trained field, as [`Self::fetch`] brings it.
    ///
    /// # Errors
    /// [`Error::Diverged`], [`Error::Cancelled`], or the device's.
    pub fn into_field(mut self, cancelled: &dyn Fn() -> bool) -> Result<Field> {
        self.fetch(cancelled)?;
        match self.on {
            On::Cpu(trainer) => Ok(trainer.into_field()),
            #[cfg(feature = "gpu")]
            On::Gpu(trainer) => {
                report(&trainer)?;
                Ok(trainer.into_field())
            }
        }
    }
}

/// Steps after which a GPU is asked for its sums, which waits for it: the first few, as rays then change most, and some later ones.
#[cfg(feature = "gpu")]
pub(crate) fn is_reported(step: u64) -> bool {
    const EVERY: u64 = 16;
    (step + 1).is_power_of_two() || (step + 1).is_multiple_of(EVERY)
}

#[cfg(feature = "gpu")]
fn report(trainer: &GpuTrainer) -> Result<StepReport> {
    let sums = trainer.sums()?;
    if let Some(step) = sums.diverged_at {
        let quantity = not_finite(sums.squared_error, sums.loss).unwrap_or("loss");
        return Err(Error::Diverged { step, quantity });
    }
    Ok(StepReport {
        color_rays: sums.color_rays,
        squared_error: sums.squared_error,
        colored: sums.colored,
    })
}

/// What of a step's sums is not finite, if anything.
fn not_finite(squared_error: f64, loss: f64) -> Option<&'static str> {
    match (loss.is_finite(), squared_error.is_finite()) {
        (true, _) => None,
        (false, true) => Some("loss"),
        (false, false) => Some("colour"),
    }
}

/// The value below which the share `q` of `values` lies; infinite for none.
pub(super) fn quantile(values: &[f32], q: f64) -> f32 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f32::total_cmp);
    let at = (values.len() as f64 * q) as usize;
    sorted.get(at).copied().unwrap_or(f32::INFINITY)
}
