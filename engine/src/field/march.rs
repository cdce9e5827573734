//! Ray marching through occupied space.

use glam::Vec3;

use super::Field;
use super::occupancy::{Space, Walker};
use super::probe::{GROUP, Lane, Positions, add_raw_densities};
use crate::backend::cpu::lanes::Lanes;
use crate::backend::cpu::simd::dispatch;

/// One interval of a ray with the density at a point in it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RaySample {
    /// Distance from the ray's origin to the sampled point in metres.
    pub t: f32,
    /// Length of the interval in metres.
    pub dt: f32,
    /// Density in 1/m.
    pub sigma: f32,
}

/// A ray with a unit direction, so that distances are metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ray {
    pub origin: Vec3,
    pub direction: Vec3,
}

impl Ray {
    #[inline]
    pub fn at(&self, t: f32) -> Vec3 {
        self.origin + self.direction * t
    }

    /// Entry and exit distance of the box, entry clamped to 0; `None` if the ray misses it.
    #[inline]
    pub fn cross_box(&self, low: Vec3, high: Vec3) -> Option<(f32, f32)> {
        let inverse = self.direction.recip();
        let (a, b) = (
            (low - self.origin) * inverse,
            (high - self.origin) * inverse,
        );
        // 0 * infinity is NaN for a ray within a face's plane; min and max drop it.
        let near = a.min(b).max_element().max(0.0);
        let far = a.max(b).min_element();
        (near < far).then_some((near, far))
    }
}

/// Where along a ray to march and how.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MarchRange {
    pub t_min: f32,
    pub t_max: f32,
    /// Marching ends once the ray's own optical depth exceeds this.
    pub stop_tau: f32,
    /// Where in each interval the density is read, 0..1; 0.5 is the middle. Training draws it per ray.
    pub phase: f32,
}

/// Below this density (1/m) a sample is dropped: 100 m of it hide less than 1e-3.
pub(crate) const SIGMA_MIN: f32 = 1e-5;
/// Steps past a cell's face, so that the next look-up is in the next cell: in cells.
pub(crate) const FACE_NUDGE: f32 = 1e-3;

dispatch!(
    /// Appends the samples of one ray to `out`, near to far, and adds the optical depth reached to `tau`.
    pub(super) fn march => march_generic(
        field: &Field,
        ray: Ray,
        range: MarchRange,
        out: &mut Vec<RaySample>,
        tau: &mut f32,
    )
);

/// [`march`] compiled into its caller.
#[inline(always)]
pub(crate) fn march_generic<L: Lanes, const R: usize, const V: usize>(
    field: &Field,
    ray: Ray,
    range: MarchRange,
    out: &mut Vec<RaySample>,
    tau: &mut f32,
) {
    let (low, high) = field.bounds();
    let Some((near, far)) = ray.cross_box(low, high) else {
        return;
    };
    let end = far.min(range.t_max);
    let mut walk = Walk {
        walker: field.occupancy.walker(),
        ray,
        inverse: ray.direction.recip(),
        t: near.max(range.t_min),
        end,
        nudge_m: FACE_NUDGE * field.occupancy.cell_m(),
        step_growth: field.step_growth,
    };
    let (mut t, mut dt) = ([0.0; GROUP], [0.0; GROUP]);
    loop {
        let count = walk.next_intervals(range.phase, &mut t, &mut dt);
        if count == 0 {
            return;
        }
        let sigma = densities(field, ray, &t, count);
        for i in 0..count {
            if *tau > range.stop_tau {
                return;
            }
            if sigma[i] > SIGMA_MIN {
                *tau += sigma[i] * dt[i];
                out.push(RaySample {
                    t: t[i],
                    dt: dt[i],
                    sigma: sigma[i],
                });
            }
        }
        if *tau > range.stop_tau {
            return;
        }
    }
}

/// Steps along a ray through occupied space.
struct Walk<'a> {
    walker: Walker<'a>,
    ray: Ray,
    inverse: Vec3,
    t: f32,
    end: f32,
    nudge_m: f32,
    step_growth: f32,
}

impl Walk<'_> {
    /// Distance at which the ray leaves a cube.
    #[inline(always)]
    fn leaves(&self, corner_m: Vec3, side_m: f32) -> f32 {
        let near = (corner_m - self.ray.origin) * self.inverse;
        let far = (corner_m + side_m - self.ray.origin) * self.inverse;
        near.max(far).min_element()
    }

    /// The next intervals and the points in them at which density is read; fewer than a group only at the ray's end.
    #[inline(always)]
    fn next_intervals(&mut self, phase: f32, at: &mut Lane<f32>, dt: &mut Lane<f32>) -> usize {
        let mut count = 0;
        while self.t < self.end {
            match self.walker.at(self.ray.at(self.t)) {
                Space::Empty { corner_m, side_m } => {
                    self.t = self.leaves(corner_m, side_m).max(self.t) + self.nudge_m;
                }
                Space::Occupied { step_m } => {
                    let (corner_m, side_m) = self.walker.cell();
                    let leave = self.leaves(corner_m, side_m).min(self.end);
                    // The cell at t was just looked up, so at least one interval begins in it.
                    loop {
                        let step = step_m.max(self.step_growth * self.t);
                        let step = step.min(self.end - self.t);
                        at[count] = self.t + phase * step;
                        dt[count] = step;
                        self.t += step.max(self.nudge_m);
                        count += 1;
                        if count == GROUP {
                            return count;
                        }
                        if self.t >= leave {
                            break;
                        }
                    }
                }
            }
        }
        count
    }
}

/// Densities in 1/m at the first `count` distances; 0 where no level stores anything.
#[inline(always)]
fn densities(field: &Field, ray: Ray, t: &Lane<f32>, count: usize) -> Lane<f32> {
    let at = Positions::on_ray(ray.origin.to_array(), ray.direction.to_array(), t);
    let (mut raw, mut stored) = ([0.0; GROUP], [false; GROUP]);
    for level in &field.levels {
        add_raw_densities(level, &at, count, &mut raw, &mut stored);
    }
    let activation = field.activation;
    let mut sigma = [0.0; GROUP];
    for i in 0..GROUP {
        let value = activation.sigma(raw[i]);
        sigma[i] = if stored[i] { value } else { 0.0 };
    }
    sigma
}
