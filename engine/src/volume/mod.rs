//! Volume rendering and losses: the one place each formula and its gradient stands.

mod composite;
mod loss;
#[cfg(test)]
mod tests;

pub use composite::{Weights, add_optical_depth_gradient, weights};
pub use loss::{
    Loss, color_loss, depth_loss, entropy_loss, opaque_loss, printed_rectified_loss,
    sample_color_loss, transparent_loss,
};
