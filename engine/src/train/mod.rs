//! Fitting a field to posed images.

mod control;
mod input;
mod preset;
pub mod ray;

pub use control::{NoControl, Progress, Stage, TrainControl};
pub use input::{BackgroundInput, ObjectInput, Trained};
pub use preset::{Budget, TrainPreset};
