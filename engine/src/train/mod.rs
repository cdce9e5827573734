//! Fitting a field to posed images.
//!
//! [`train_background`] and [`train_object`] check their input, prepare a field (bricks and density where LiDAR returns lie),
//! then loop: draw rays, take a step on the backend, now and then survey what is occupied and store finer bricks there.

mod average;
mod background;
mod bounded;
mod control;
mod dense_box;
pub mod dvgo;
mod evaluate;
mod fit;
mod free_space;
mod input;
mod object;
mod options;
mod paper;
mod preset;
pub mod ray;
mod refine;
#[cfg(test)]
mod refusal_tests;
mod sampler;
mod seed;
mod survey;
#[cfg(test)]
pub(crate) mod tests;
mod validate;

pub use background::train_background;
pub use bounded::{seen_box, train_bounded};
pub use control::{NoControl, Progress, Stage, TrainControl};
pub use dvgo::{DvgoRecipe, frustum_box, train_dvgo};
pub use input::{BackgroundInput, BoundedInput, LidarBeam, ObjectInput, Trained};
pub use object::{padded_half_m, train_object};
pub use options::TrainOptions;
pub use preset::{Budget, Surveys, TrainPreset};
pub use sampler::RayMix;
