//! Samples of a ray at a fixed pitch, from where it enters the box.

use glam::Vec3;

use super::grid::{Cell, Shape};
use super::mask::{Bit, NodeMask, nearest};
use crate::field::Ray;
use crate::field::activation::{sigmoid, softplus};

/// A ray ends behind the sample that leaves less than 1e-3 of its light: -ln 1e-3.
pub(crate) const STOP_TAU: f32 = 6.907_755;
/// Samples whose densities are asked for together.
const AHEAD: usize = 16;
/// Taken off a distance to a block's face, in steps, so that rounding never skips a sample.
const STEP_SLACK: f32 = 1e-3;

/// A sample of enough opacity to take part.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Sample {
    /// Node coordinates.
    pub(super) q: Vec3,
    /// Optical depth of its interval.
    pub(super) tau: f32,
    /// Derivative of `tau` by the raw density.
    pub(super) slope: f32,
}

/// The density as rays see it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Medium<'a> {
    pub(crate) shape: &'a Shape,
    pub(crate) density: &'a [f32],
    pub(crate) mask: &'a NodeMask,
    /// Added to raw densities before the softplus.
    pub(crate) shift: f32,
    /// Length of a step in base voxels.
    pub(crate) interval: f32,
    /// Raw densities up to here are too thin to matter.
    pub(crate) raw_min: f32,
    pub(crate) step_m: f32,
}

/// Where a ray's samples lie, in node coordinates.
#[derive(Clone, Copy, Debug)]
struct Pitch {
    start: Vec3,
    step: Vec3,
    count: u32,
}

impl Medium<'_> {
    /// Appends the samples of a ray, near to far, from `near_m` metres on.
    ///
    /// Densities lie all over memory, and waiting for each took most of the time; so those of a few samples are asked for before
    /// the first is used.
    #[inline(always)]
    pub(super) fn march(&self, ray: Ray, near_m: f32, out: &mut Vec<Sample>) {
        let mut ahead = [(Vec3::ZERO, Cell::default()); AHEAD];
        let (mut waiting, mut tau) = (0, 0.0);
        self.for_each_masked(ray, near_m, |q| {
            let cell = self.shape.cell(q);
            cell.prefetch_values(self.density);
            ahead[waiting] = (q, cell);
            waiting += 1;
            if waiting < AHEAD {
                return true;
            }
            waiting = 0;
            self.sample(&ahead, &mut tau, out)
        });
        if tau <= STOP_TAU {
            self.sample(&ahead[..waiting], &mut tau, out);
        }
    }

    /// Appends those of the points that are dense enough; `false` once no light is left.
    #[inline(always)]
    fn sample(&self, points: &[(Vec3, Cell)], tau: &mut f32, out: &mut Vec<Sample>) -> bool {
        for (q, cell) in points {
            let raw = cell.interpolate(self.density);
            if raw > self.raw_min {
                let x = raw + self.shift;
                let sample = Sample {
                    q: *q,
                    tau: self.interval * softplus(x),
                    slope: self.interval * sigmoid(x),
                };
                *tau += sample.tau;
                out.push(sample);
                if *tau > STOP_TAU {
                    return false;
                }
            }
        }
        true
    }

    /// Whether any sample of a ray lies where the mask has a bit.
    pub(super) fn hits_mask(&self, ray: Ray, near_m: f32) -> bool {
        let mut hit = false;
        self.for_each_masked(ray, near_m, |_| {
            hit = true;
            false
        });
        hit
    }

    /// Calls `visit` for the samples where the mask has a bit, until it says no.
    #[inline(always)]
    pub(super) fn for_each_masked(
        &self,
        ray: Ray,
        near_m: f32,
        mut visit: impl FnMut(Vec3) -> bool,
    ) {
        let Some(pitch) = self.pitch(ray, near_m) else {
            return;
        };
        let inverse = pitch.step.recip();
        let last = (self.shape.nodes - 1).as_vec3();
        let mut number = 0;
        while number < pitch.count {
            let q = pitch.start + pitch.step * number as f32;
            number += 1;
            if !(q.cmpge(Vec3::ZERO).all() && q.cmple(last).all()) {
                continue;
            }
            match self.mask.bit(nearest(q)) {
                Bit::Set => {
                    if !visit(q) {
                        return;
                    }
                }
                Bit::Clear => {}
                Bit::ClearBlock(block) => {
                    // Points whose nearest node is in the block reach half a node past its first and last.
                    let low = (block * 8).as_vec3() - 0.5;
                    let (a, b) = ((low - q) * inverse, (low + 8.0 - q) * inverse);
                    let steps = a.max(b).min_element() - STEP_SLACK;
                    number += steps.max(0.0) as u32;
                }
            }
        }
    }

    #[inline(always)]
    fn pitch(&self, ray: Ray, near_m: f32) -> Option<Pitch> {
        let (low, high) = (self.shape.low.as_vec3(), self.shape.high.as_vec3());
        let (enter, leave) = ray.cross_box(low, high)?;
        let enter = enter.max(near_m);
        let per_m = self.shape.spacing_m().as_vec3().recip();
        (enter < leave).then(|| Pitch {
            start: (ray.at(enter) - low) * per_m,
            step: ray.direction * self.step_m * per_m,
            count: ((leave - enter) / self.step_m).ceil() as u32,
        })
    }
}

/// The raw density whose sample of `interval` base voxels has the opacity `alpha`.
pub(super) fn raw_of_alpha(alpha: f64, interval: f64, shift: f64) -> f32 {
    let softplus = -(-alpha).ln_1p() / interval;
    (softplus.exp_m1().ln() - shift) as f32
}
