//! The engine's view of a job's control.

use backlot_engine::train::{Progress as EngineProgress, Stage, TrainControl};

use crate::domain::job::Progress;
use crate::jobs::worker_port::JobControl;

/// Maps one training run onto a part of a job's progress bar.
#[derive(Debug)]
pub(super) struct RunControl<'a> {
    control: &'a JobControl,
    /// Where the run begins and how much of the bar it fills.
    start: f64,
    share: f64,
    began_s: f64,
    /// What is trained, for people.
    what: String,
}

/// Share of a run that training fills; evaluation takes the rest.
const TRAIN_SHARE: f64 = 0.93;

impl<'a> RunControl<'a> {
    pub(super) fn new(control: &'a JobControl, start: f64, share: f64, what: String) -> Self {
        Self {
            control,
            start,
            share,
            began_s: control.elapsed_s(),
            what,
        }
    }
}

impl TrainControl for RunControl<'_> {
    fn progress(&self, progress: EngineProgress) {
        let done = progress.step as f64 / progress.step_count.max(1) as f64;
        let (stage, fraction) = match progress.stage {
            Stage::Prepare => ("seed", 0.0),
            Stage::Train => ("train", TRAIN_SHARE * done),
            Stage::Evaluate => ("evaluate", TRAIN_SHARE),
        };
        let message = match progress.psnr_train {
            Some(psnr) => format!("{}: {psnr:.1} dB on training rays", self.what),
            None => self.what.clone(),
        };
        self.control.report(Progress {
            fraction: self.start + self.share * fraction,
            stage: stage.to_owned(),
            step: progress.step,
            step_count: progress.step_count,
            message,
        });
    }

    fn cancelled(&self) -> bool {
        self.control.cancelled()
    }

    fn seconds(&self) -> f64 {
        self.control.elapsed_s() - self.began_s
    }
}

/// Reports a stage outside training.
pub(super) fn report(
    control: &JobControl,
    fraction: f64,
    stage: &str,
    step: usize,
    step_count: usize,
    message: &str,
) {
    control.report(Progress {
        fraction,
        stage: stage.to_owned(),
        step: step as u64,
        step_count: step_count as u64,
        message: message.to_owned(),
    });
}
