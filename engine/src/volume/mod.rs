//! Volume rendering and losses: the one place each formula and its gradient stands.
//!
//! Formulas are generic over [`Real`], so that what trains in f32 is checked in f64.

mod composite;
mod distortion;
mod exposure;
mod loss;
mod real;
#[cfg(test)]
mod tests;

pub use composite::{Weights, add_optical_depth_gradient, weights, weights_of};
pub use distortion::{add_distortion_gradient, warped};
pub use exposure::{Exposure, ExposureGradient};
pub use loss::{
    Loss, color_loss, composited_depth_loss, depth_loss, entropy_loss, opaque_loss,
    printed_rectified_loss, sample_color_loss, transparent_loss, variation_loss,
};
pub use real::Real;
