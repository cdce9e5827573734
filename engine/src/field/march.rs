//! Ray marching through occupied space.

use glam::Vec3;

use super::Field;
use super::occupancy::Space;

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

/// Appends the samples of one ray to `out`, near to far, and returns the optical depth reached.
pub(super) fn march(field: &Field, ray: Ray, range: MarchRange, out: &mut Vec<RaySample>) -> f32 {
    let (low, high) = field.bounds();
    let Some((near, far)) = ray.cross_box(low, high) else {
        return 0.0;
    };
    let inverse = ray.direction.recip();
    let nudge_m = FACE_NUDGE * field.occupancy.cell_m();
    let (mut t, end) = (near.max(range.t_min), far.min(range.t_max));
    let mut tau = 0.0;
    while t < end && tau <= range.stop_tau {
        match field.occupancy.at(ray.at(t)) {
            Space::Empty { corner_m, side_m } => {
                let (a, b) = (
                    (corner_m - ray.origin) * inverse,
                    (corner_m + side_m - ray.origin) * inverse,
                );
                t = a.max(b).min_element().max(t) + nudge_m;
            }
            Space::Occupied { step_m } => {
                let dt = step_m.max(field.step_growth * t).min(end - t);
                let at = t + range.phase * dt;
                let sigma = field.sigma(ray.at(at));
                if sigma > SIGMA_MIN {
                    tau += sigma * dt;
                    out.push(RaySample { t: at, dt, sigma });
                }
                t += dt.max(nudge_m);
            }
        }
    }
    tau
}
