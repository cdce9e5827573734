//! Progress on standard error: bars on a terminal, a line now and then elsewhere.

use std::cell::Cell;
use std::io::IsTerminal;
use std::time::{Duration, Instant};

use backlot_client::upload::UploadProgress;
use backlot_proto::v1;
use indicatif::{ProgressBar, ProgressStyle};

/// Without a terminal, lines of one task are at least this far apart.
const LINE_INTERVAL: Duration = Duration::from_secs(10);

/// Steps of a bar that shows a fraction.
const FRACTION_STEPS: u64 = 1000;

/// The progress of one task.
pub(crate) struct Progress {
    bar: ProgressBar,
    /// Only without a terminal: when the last line was written.
    last_line: Option<Cell<Option<Instant>>>,
    label: String,
}

impl Progress {
    /// A task measured in bytes.
    pub(crate) fn bytes(label: &str) -> Self {
        Self::new(label, "{msg:24} {wide_bar} {bytes}/{total_bytes} {eta}")
    }

    /// A task measured in pieces.
    pub(crate) fn count(label: &str, total: u64) -> Self {
        let progress = Self::new(label, "{msg:24} {wide_bar} {pos}/{len} {eta}");
        progress.bar.set_length(total);
        progress
    }

    /// A job, which says itself how far it is.
    pub(crate) fn job(label: &str) -> Self {
        let progress = Self::new(
            label,
            "{msg:24} {wide_bar} {percent:>3}% {prefix} {elapsed}",
        );
        progress.bar.set_length(FRACTION_STEPS);
        progress
    }

    fn new(label: &str, template: &str) -> Self {
        let terminal = std::io::stderr().is_terminal();
        let bar = if terminal {
            ProgressBar::new(0)
        } else {
            ProgressBar::hidden()
        };
        bar.set_style(ProgressStyle::with_template(template).expect("the template is constant"));
        bar.set_message(label.to_owned());
        Self {
            bar,
            last_line: (!terminal).then(|| Cell::new(None)),
            label: label.to_owned(),
        }
    }

    pub(crate) fn set_bytes(&self, progress: UploadProgress) {
        self.bar.set_length(progress.total_bytes);
        self.bar.set_position(progress.present_bytes);
        let share = progress.present_bytes as f64 / progress.total_bytes.max(1) as f64;
        self.line(|| format!("{:.0} %", 100.0 * share));
    }

    pub(crate) fn advance(&self) {
        self.bar.inc(1);
        self.line(|| format!("{}/{}", self.bar.position(), self.bar.length().unwrap_or(0)));
    }

    pub(crate) fn set_job(&self, job: &v1::Job) {
        let Some(progress) = &job.progress else {
            return;
        };
        self.bar
            .set_position((progress.fraction * FRACTION_STEPS as f64) as u64);
        let stage = match progress.message.as_str() {
            "" => progress.stage.clone(),
            message => message.to_owned(),
        };
        self.bar.set_prefix(stage.clone());
        self.line(|| format!("{:.0} % {stage}", 100.0 * progress.fraction));
    }

    /// Ends the bar with a last word.
    pub(crate) fn finish(self, outcome: &str) {
        self.bar.finish_and_clear();
        eprintln!("{}: {outcome}", self.label);
    }

    fn line(&self, text: impl Fn() -> String) {
        let Some(last) = &self.last_line else {
            return;
        };
        let now = Instant::now();
        let due = last
            .get()
            .is_none_or(|at| now.duration_since(at) >= LINE_INTERVAL);
        if due {
            last.set(Some(now));
            eprintln!("{}: {}", self.label, text());
        }
    }
}
