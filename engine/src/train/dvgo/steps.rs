//! Steps of a stage on either backend.

use super::cpu_steps::CpuSteps;
use super::pixels::PixelRay;
use super::stage::Stage;
#[cfg(feature = "gpu")]
use crate::backend::gpu::GpuGrid;
use crate::backend::{GridDevice, GridOn};
use crate::{Error, Result};

/// What takes a stage's steps, with its optimiser state: of a stage whose shape changes a new one must be opened.
#[derive(Debug)]
pub(crate) struct Steps<const C: usize> {
    on: On<C>,
    /// Number of the last step within the run.
    last: u64,
}

#[derive(Debug)]
enum On<const C: usize> {
    Cpu(Box<CpuSteps<C>>),
    #[cfg(feature = "gpu")]
    Gpu(Box<GpuGrid>),
}

/// Mean squared error and loss of a step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct StepError {
    pub(crate) squared_error: f64,
    pub(crate) loss: f64,
}

impl<const C: usize> Steps<C> {
    /// A fresh optimiser for a stage as it is. `cancelled` is asked between pieces of what goes to a device.
    ///
    /// # Errors
    /// [`Error::OutOfMemory`] where the grid does not fit on the device, [`Error::Cancelled`], or the device's.
    pub(crate) fn open(
        device: &GridDevice,
        stage: &Stage<C>,
        cancelled: &dyn Fn() -> bool,
    ) -> Result<Self> {
        let on = match &device.on {
            GridOn::Cpu(arithmetic) => {
                if cancelled() {
                    return Err(Error::Cancelled);
                }
                On::Cpu(Box::new(CpuSteps::new(stage, *arithmetic)))
            }
            #[cfg(feature = "gpu")]
            GridOn::Gpu(gpu) => On::Gpu(Box::new(gpu.open_grid(stage, cancelled)?)),
        };
        Ok(Self { on, last: 0 })
    }

    /// Takes step `number` of the run on `rays`. A GPU tells the error of some steps only, and works on the last one while the next is drawn.
    ///
    /// # Errors
    /// [`Error::Diverged`], after which nothing has moved, [`Error::Cancelled`], or the device's.
    pub(crate) fn step(
        &mut self,
        stage: &mut Stage<C>,
        rays: &[PixelRay],
        number: u64,
        cancelled: &dyn Fn() -> bool,
    ) -> Result<Option<StepError>> {
        self.last = number;
        match &mut self.on {
            On::Cpu(steps) => {
                if cancelled() {
                    return Err(Error::Cancelled);
                }
                let error = steps.step(stage, rays);
                if !error.loss.is_finite() {
                    return Err(diverged(number));
                }
                Ok(Some(error))
            }
            #[cfg(feature = "gpu")]
            On::Gpu(grid) => {
                grid.step(stage, rays, cancelled)?;
                let is_reported = crate::backend::is_reported(stage.age);
                stage.age += 1;
                if is_reported {
                    report(grid, stage, number).map(Some)
                } else {
                    Ok(None)
                }
            }
        }
    }

    /// Brings the stage's values up to date.
    ///
    /// # Errors
    /// As [`Self::step`].
    pub(crate) fn fetch(&self, stage: &mut Stage<C>, cancelled: &dyn Fn() -> bool) -> Result<()> {
        match &self.on {
            On::Cpu(_) => {
                let _ = (stage, cancelled);
                Ok(())
            }
            #[cfg(feature = "gpu")]
            On::Gpu(grid) => {
                report(grid, stage, self.last)?;
                grid.fetch_density(&mut stage.density, cancelled)?;
                grid.fetch_colors(&mut stage.colors, cancelled)?;
                grid.fetch_network(stage.mlp.as_mut())?;
                Ok(())
            }
        }
    }

    /// Takes out of the stage's mask what has become thin.
    ///
    /// # Errors
    /// As [`Self::step`].
    pub(crate) fn renew_mask(
        &mut self,
        stage: &mut Stage<C>,
        cancelled: &dyn Fn() -> bool,
    ) -> Result<()> {
        match &self.on {
            On::Cpu(_) => {
                let _ = cancelled;
                stage.renew_mask();
            }
            #[cfg(feature = "gpu")]
            On::Gpu(grid) => {
                grid.fetch_density(&mut stage.density, cancelled)?;
                stage.renew_mask();
                grid.write_mask(&stage.mask);
            }
        }
        Ok(())
    }
}

fn diverged(step: u64) -> Error {
    let quantity = "loss";
    Error::Diverged { step, quantity }
}

/// The error of the last step, which was number `last` of the run; waits for it.
#[cfg(feature = "gpu")]
fn report<const C: usize>(grid: &GpuGrid, stage: &Stage<C>, last: u64) -> Result<StepError> {
    let sums = grid.sums()?;
    if let Some(at) = sums.diverged_at {
        // The device counts the steps of this optimiser.
        return Err(diverged(last - (stage.age - 1 - at)));
    }
    Ok(StepError {
        squared_error: sums.squared_error / stage.recipe.rays as f64,
        loss: sums.loss,
    })
}
