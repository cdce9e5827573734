//! What lies beyond the box: a learned map over directions.

use std::f32::consts::{PI, TAU};
use std::fmt;

use glam::Vec3;

use super::activation::sigmoid;

/// The four texels around a direction and their bilinear weights.
#[derive(Clone, Copy, Debug)]
pub struct SkyTexels {
    pub texels: [u32; 4],
    pub weights: [f32; 4],
}

/// One latitude-longitude grid of colour logits; x is the heading and wraps around, y the elevation from -90 degrees up.
#[derive(Clone, PartialEq)]
pub struct SkyGrid {
    width: u32,
    height: u32,
    logits: Vec<[f32; 3]>,
}

/// The colour of a direction at infinity: the logistic of a sum of grids, coarse to fine.
///
/// Coarse grids colour directions that no training ray took; z of the local frame is up.
#[derive(Clone, Debug, PartialEq)]
pub struct SkyMap {
    grids: Vec<SkyGrid>,
}

impl SkyGrid {
    pub fn new(width: u32, height: u32) -> Self {
        Self {
            width,
            height,
            logits: vec![[0.0; 3]; width as usize * height as usize],
        }
    }

    pub fn width(&self) -> u32 {
        self.width
    }

    pub fn height(&self) -> u32 {
        self.height
    }

    pub fn logits(&self) -> &[[f32; 3]] {
        &self.logits
    }

    pub fn logits_mut(&mut self) -> &mut [[f32; 3]] {
        &mut self.logits
    }

    #[inline]
    pub fn texels(&self, direction: Vec3) -> SkyTexels {
        let heading = libm::atan2f(direction.y, direction.x);
        let elevation = libm::asinf(direction.z.clamp(-1.0, 1.0));
        let u = (heading / TAU + 0.5) * self.width as f32 - 0.5;
        let v = (elevation / PI + 0.5) * self.height as f32 - 0.5;
        // Both are above -1, so truncation after a shift is the floor, without a call where the target has no rounding.
        let (u0, v0) = ((u + 1.0) as i32 - 1, (v + 1.0) as i32 - 1);
        let (fu, fv) = (u - u0 as f32, v - v0 as f32);
        let left = u0.rem_euclid(self.width as i32) as u32;
        let right = (left + 1) % self.width;
        let low = v0.clamp(0, self.height as i32 - 1) as u32;
        let high = (v0 + 1).clamp(0, self.height as i32 - 1) as u32;
        SkyTexels {
            texels: [
                low * self.width + left,
                low * self.width + right,
                high * self.width + left,
                high * self.width + right,
            ],
            weights: [
                (1.0 - fu) * (1.0 - fv),
                fu * (1.0 - fv),
                (1.0 - fu) * fv,
                fu * fv,
            ],
        }
    }
}

impl SkyMap {
    pub fn new(grids: Vec<SkyGrid>) -> Self {
        Self { grids }
    }

    pub fn grids(&self) -> &[SkyGrid] {
        &self.grids
    }

    pub fn grids_mut(&mut self) -> &mut [SkyGrid] {
        &mut self.grids
    }

    /// sRGB in 0..1.
    pub fn color(&self, direction: Vec3) -> [f32; 3] {
        let mut logits = [0.0f32; 3];
        for grid in &self.grids {
            let at = grid.texels(direction);
            for (texel, weight) in at.texels.into_iter().zip(at.weights) {
                for (sum, logit) in logits.iter_mut().zip(grid.logits[texel as usize]) {
                    *sum += logit * weight;
                }
            }
        }
        logits.map(sigmoid)
    }
}

/// Sizes only.
impl fmt::Debug for SkyGrid {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("SkyGrid")
            .field("width", &self.width)
            .field("height", &self.height)
            .finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn is_continuous_where_the_heading_wraps_and_finite_at_the_poles() {
        let mut grid = SkyGrid::new(16, 8);
        for (i, logit) in grid.logits_mut().iter_mut().enumerate() {
            *logit = [(i % 7) as f32 - 3.0; 3];
        }
        let sky = SkyMap::new(vec![grid]);
        let left = sky.color(Vec3::new(-1.0, 1e-5, 0.2).normalize_or_zero());
        let right = sky.color(Vec3::new(-1.0, -1e-5, 0.2).normalize_or_zero());
        assert!((left[0] - right[0]).abs() < 1e-3, "{left:?} {right:?}");
        for pole in [Vec3::Z, Vec3::NEG_Z] {
            assert!(sky.color(pole)[0].is_finite());
        }
    }
}
