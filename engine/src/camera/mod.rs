//! Cameras, rays and rigid transforms. Transforms are named `target_from_source`.

mod distortion;
mod pinhole;
mod rigid;

pub use distortion::Distortion;
pub use pinhole::{Camera, NEAR_M};
pub use rigid::Rigid;
