//! How much of the sun reaches the places in and around a cuboid.

use glam::{DVec3, UVec3};

use crate::camera::Rigid;
use crate::field::{Field, RaySample};

/// Shadow edges are found to this; a field's own are not sharper.
const CELL_M: f64 = 0.25;
/// The cuboid's own pixels reach this far out of it; rays to the sun start outside.
const MARGIN_M: f64 = 0.2;
/// Rays to the sun start this far above the ground, clear of its haze.
pub(super) const SUN_LIFT_M: f64 = 0.7;
/// What is further away along the ray was hardly seen.
pub(super) const SUN_RANGE_M: f64 = 60.0;
const STOP_TAU: f32 = 4.0;

/// Parts of the sun, 0..=1, on a grid in a cuboid's frame.
#[derive(Clone, Debug)]
pub(super) struct SunGrid {
    low: DVec3,
    step: DVec3,
    counts: UVec3,
    /// x runs fastest.
    parts: Vec<f64>,
}

impl SunGrid {
    /// For a cuboid standing at `local_from_cuboid`; `through(p, from)` gives the part of the sun that reaches a local point of it, past
    /// what lies on the way from the point `from` where the ray has left the cuboid.
    pub(super) fn new(
        size_m: DVec3,
        local_from_cuboid: &Rigid,
        sun_direction_local: DVec3,
        mut through: impl FnMut(DVec3, DVec3) -> f64,
    ) -> Self {
        let half = size_m * 0.5 + DVec3::splat(MARGIN_M);
        let counts = (2.0 * half / CELL_M).ceil().as_uvec3() + UVec3::ONE;
        let step = 2.0 * half / (counts - UVec3::ONE).as_dvec3();
        let sun = local_from_cuboid.inverse().direction(sun_direction_local);
        let part = |i: u32| {
            let (x, y) = (i % counts.x, i / counts.x % counts.y);
            let cell = UVec3::new(x, y, i / (counts.x * counts.y));
            let p = -half + cell.as_dvec3() * step;
            let clear = clear_m(p, sun, half).max(lift_m(p, size_m, sun_direction_local));
            let from = local_from_cuboid.point(p + sun * clear);
            through(local_from_cuboid.point(p), from)
        };
        Self {
            low: -half,
            step,
            counts,
            parts: (0..counts.element_product()).map(part).collect(),
        }
    }

    /// The same part everywhere.
    pub(super) fn even(part: f64) -> Self {
        Self {
            low: DVec3::ZERO,
            step: DVec3::ONE,
            counts: UVec3::splat(2),
            parts: vec![part; 8],
        }
    }

    /// The part of the sun at a point of the cuboid's frame, trilinear; beyond the grid that of its rim.
    pub(super) fn at(&self, p: DVec3) -> f64 {
        let last = (self.counts - UVec3::splat(2)).as_dvec3();
        let c = ((p - self.low) / self.step).clamp(DVec3::ZERO, last + DVec3::ONE);
        let cell = c.min(last).floor();
        let f = c - cell;
        let cell = cell.as_uvec3();
        let mut sum = 0.0;
        for corner in 0..8 {
            let d = UVec3::new(corner & 1, corner >> 1 & 1, corner >> 2);
            let weight = (0..3)
                .map(|a| if d[a] == 1 { f[a] } else { 1.0 - f[a] })
                .product::<f64>();
            let at = cell + d;
            let index = (at.z * self.counts.y + at.y) * self.counts.x + at.x;
            sum += weight * self.parts[index as usize];
        }
        sum
    }

    pub(super) fn mean(&self) -> f64 {
        self.parts.iter().sum::<f64>() / self.parts.len() as f64
    }
}

/// Distance to the end of the box along `direction`, from inside.
fn clear_m(p: DVec3, direction: DVec3, half: DVec3) -> f64 {
    let ends = (half * direction.signum() - p) / direction;
    ends.min_element().max(0.0)
}

fn lift_m(p: DVec3, size_m: DVec3, sun_direction_local: DVec3) -> f64 {
    let height = p.z + 0.5 * size_m.z;
    (SUN_LIFT_M - height).max(0.0) / sun_direction_local.z
}

/// The part of light that a field lets through between `origin` and `range_m` along the unit `direction`.
pub(super) fn transmittance(
    field: &Field,
    origin: DVec3,
    direction: DVec3,
    range_m: f64,
    samples: &mut Vec<RaySample>,
) -> f64 {
    samples.clear();
    let (origin, direction) = (origin.as_vec3(), direction.as_vec3());
    let tau = field.march(origin, direction, 0.0, range_m as f32, STOP_TAU, samples);
    f64::from((-tau).exp())
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: DVec3 = DVec3::new(4.0, 2.0, 1.5);

    #[test]
    fn a_shadow_edge_lies_where_it_is_and_the_cuboid_does_not_hide_itself() {
        // All that is hidden lies at local x < 10, the middle of the cuboid; the sun stands to the left.
        let pose = Rigid::from_heading(std::f64::consts::PI, DVec3::new(10.0, 3.0, 0.75));
        let sun = DVec3::new(0.0, 1.0, 1.0).normalize();
        let grid = SunGrid::new(SIZE, &pose, sun, |_, from| {
            let inside = (pose.inverse().point(from)).abs().cmple(SIZE * 0.5).all();
            assert!(!inside, "a ray begins within the cuboid: {from}");
            if from.x < 10.0 { 0.0 } else { 1.0 }
        });
        // The cuboid is turned round: its front is in the shade.
        assert_eq!(grid.at(DVec3::new(1.5, 0.3, 0.0)), 0.0);
        assert_eq!(grid.at(DVec3::new(-1.5, -0.3, 0.5)), 1.0);
        assert_eq!(grid.at(DVec3::new(-9.0, 0.0, 9.0)), 1.0);
        assert!((grid.mean() - 0.5).abs() < 0.05, "{}", grid.mean());
    }
}
