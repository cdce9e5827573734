//! Per-view exposure: an affine map of the composited colour, channel by channel.

use super::real::Real;

/// `color' = exp(log_gain) color + bias`; all 0 is the identity.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Exposure<R = f32> {
    pub log_gain: [R; 3],
    pub bias: [R; 3],
}

/// Gradients of a loss by what [`Exposure::apply`] takes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ExposureGradient<R = f32> {
    pub color: [R; 3],
    pub log_gain: [R; 3],
    pub bias: [R; 3],
}

impl<R: Real> Exposure<R> {
    #[inline]
    pub fn gain(&self) -> [R; 3] {
        self.log_gain.map(|g| g.exp_m1() + R::ONE)
    }

    #[inline]
    pub fn apply(&self, color: [R; 3]) -> [R; 3] {
        let gain = self.gain();
        std::array::from_fn(|c| gain[c] * color[c] + self.bias[c])
    }

    /// Gradients from the one by the corrected colour.
    #[inline]
    pub fn gradient(&self, color: [R; 3], by_corrected: [R; 3]) -> ExposureGradient<R> {
        let gain = self.gain();
        ExposureGradient {
            color: std::array::from_fn(|c| gain[c] * by_corrected[c]),
            log_gain: std::array::from_fn(|c| gain[c] * color[c] * by_corrected[c]),
            bias: by_corrected,
        }
    }
}
