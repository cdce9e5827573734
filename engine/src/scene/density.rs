//! What composition asks of a density field, so that its geometry is tested on analytic scenes.

use glam::DVec3;

/// Optical depth at which half of the light is gone: where a surface is said to be.
pub const HALF_TAU: f64 = std::f64::consts::LN_2;

/// A volume density in a local metric frame.
pub trait DensityField: Sync {
    /// Density in 1/m.
    fn sigma(&self, p: DVec3) -> f64;

    /// Distance along the unit `direction` at which the optical depth reaches [`HALF_TAU`]; `None` if not before `t_max`.
    fn hit(&self, origin: DVec3, direction: DVec3, t_max: f64) -> Option<f64>;

    /// Corners of the box outside of which the density is 0.
    fn bounds(&self) -> (DVec3, DVec3);
}
