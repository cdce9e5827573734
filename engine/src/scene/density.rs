//! What composition asks of a density field, so that its geometry is tested on analytic scenes.

use glam::DVec3;

use crate::field::{Field, RaySample};

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

impl DensityField for Field {
    fn sigma(&self, p: DVec3) -> f64 {
        f64::from(Self::sigma(self, p.as_vec3()))
    }

    fn hit(&self, origin: DVec3, direction: DVec3, t_max: f64) -> Option<f64> {
        let mut samples: Vec<RaySample> = Vec::with_capacity(256);
        let (origin, direction) = (origin.as_vec3(), direction.as_vec3());
        self.march(
            origin,
            direction,
            0.0,
            t_max as f32,
            HALF_TAU as f32,
            &mut samples,
        );
        let mut tau = 0.0;
        for sample in samples {
            let step = f64::from(sample.sigma * sample.dt);
            if tau + step >= HALF_TAU {
                let from = f64::from(sample.t - 0.5 * sample.dt);
                return Some(from + (HALF_TAU - tau) / f64::from(sample.sigma));
            }
            tau += step;
        }
        None
    }

    fn bounds(&self) -> (DVec3, DVec3) {
        let (low, high) = Self::bounds(self);
        (low.as_dvec3(), high.as_dvec3())
    }
}
