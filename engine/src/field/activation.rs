//! Activations of density and colour.

use super::transcendental::exp_m1;
pub use super::transcendental::{sigmoid, softplus};

/// Turns raw lattice density into sigma in 1/m.
///
/// `sigma = softplus(raw + act_shift) / base_voxel_m`, DVGO's activation in a metric unit: its alpha over one base voxel
/// is `1 - exp(-softplus(raw + act_shift))`.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct DensityActivation {
    /// Added to the raw density; sets the opacity of untouched space.
    pub act_shift: f32,
    /// Length in metres whose opacity `softplus` describes.
    pub base_voxel_m: f32,
}

impl DensityActivation {
    /// The activation under which raw density 0 has opacity `alpha_init` over one base voxel.
    pub fn from_alpha(alpha_init: f64, base_voxel_m: f32) -> Self {
        // softplus(s) = -ln(1 - alpha)  =>  s = ln((1 - alpha)^-1 - 1); DVGO eq. 9 with unit interval.
        let act_shift = (1.0 / (1.0 - alpha_init) - 1.0).ln() as f32;
        Self {
            act_shift,
            base_voxel_m,
        }
    }

    /// Density in 1/m.
    #[inline(always)]
    pub fn sigma(&self, raw: f32) -> f32 {
        softplus(raw + self.act_shift) / self.base_voxel_m
    }

    /// Derivative of [`Self::sigma`] by the raw density, from sigma itself: the logistic of x is `1 - exp(-softplus(x))`.
    #[inline]
    pub fn slope(&self, sigma: f32) -> f32 {
        -exp_m1(-sigma * self.base_voxel_m) / self.base_voxel_m
    }

    /// The raw density of a wanted sigma, inverse of [`Self::sigma`].
    pub fn raw(&self, sigma: f32) -> f32 {
        // ln(e^y - 1), which is y for large y.
        let y = sigma * self.base_voxel_m;
        let x = if y > 20.0 { y } else { y.exp_m1().ln() };
        x - self.act_shift
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn untouched_space_has_the_initial_opacity() {
        let activation = DensityActivation::from_alpha(1e-3, 0.1);
        let alpha = -(-activation.sigma(0.0) * 0.1).exp_m1();
        assert!((alpha - 1e-3).abs() < 1e-6, "{alpha}");
    }

    #[test]
    fn slope_is_the_derivative_and_raw_the_inverse() {
        let activation = DensityActivation::from_alpha(1e-2, 0.2);
        for raw in [-3.0f32, 0.0, 2.0, 5.0, 12.0] {
            let h = 1e-2;
            let numeric = (activation.sigma(raw + h) - activation.sigma(raw - h)) / (2.0 * h);
            let analytic = activation.slope(activation.sigma(raw));
            assert!(
                (numeric - analytic).abs() < 1e-2 * analytic,
                "{raw}: {numeric} {analytic}"
            );
            assert!((activation.raw(activation.sigma(raw)) - raw).abs() < 1e-2);
        }
    }
}
