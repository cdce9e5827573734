//! What a trainer tells its caller and asks of it.

/// What a training run is doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    Prepare,
    Train,
    Evaluate,
}

use crate::field::Field;

/// A training run's state at one moment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Progress {
    pub stage: Stage,
    pub step: u64,
    pub step_count: u64,
    /// Decibels over the colour rays of recent steps; `None` before the first.
    pub psnr_train: Option<f64>,
}

/// The caller's side of a training run. Called from one thread, once a step at most.
pub trait TrainControl: Sync {
    fn progress(&self, progress: Progress);

    /// Whether [`Self::inspect`] is wanted after this step: on a GPU the field must be fetched for it.
    fn looks(&self, _progress: Progress) -> bool {
        false
    }

    /// Shows the field after a step, to be looked at and not changed; what this takes is for [`Self::seconds`] to leave out.
    fn inspect(&self, _progress: Progress, _field: &Field) {}

    /// Asked before every step; `true` ends the run with [`crate::Error::Cancelled`].
    fn cancelled(&self) -> bool;

    /// Seconds since the run began.
    fn seconds(&self) -> f64;
}

/// Never cancels and hears nothing; its clock stands still, so a budget in seconds never ends a run.
#[derive(Clone, Copy, Debug, Default)]
pub struct NoControl;

impl TrainControl for NoControl {
    fn progress(&self, _: Progress) {}

    fn cancelled(&self) -> bool {
        false
    }

    fn seconds(&self) -> f64 {
        0.0
    }
}
