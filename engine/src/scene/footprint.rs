//! The rectangle an object stands on, and the plane under it.

use glam::{DMat3, DQuat, DVec2, DVec3};

use crate::camera::Rigid;

/// A rotated rectangle in the local x-y plane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Footprint {
    pub centre: DVec2,
    /// Unit vector of the length axis.
    pub forward: DVec2,
    /// Half extents in metres: along `forward`, across it.
    pub half: DVec2,
}

impl Footprint {
    pub fn new(centre: DVec2, heading_rad: f64, size_m: DVec3) -> Self {
        let (sin, cos) = libm::sincos(heading_rad);
        Self {
            centre,
            forward: DVec2::new(cos, sin),
            half: size_m.truncate() * 0.5,
        }
    }

    /// The footprint of a posed cuboid; small pitch and roll are ignored.
    pub fn of_cuboid(local_from_cuboid: &Rigid, size_m: DVec3) -> Self {
        Self::new(
            local_from_cuboid.translation_m.truncate(),
            local_from_cuboid.heading_rad(),
            size_m,
        )
    }

    pub fn grown(&self, margin_m: f64) -> Self {
        Self {
            half: self.half + DVec2::splat(margin_m),
            ..*self
        }
    }

    /// The point at fractions (-1..1) of the half extents.
    pub fn at(&self, along: f64, across: f64) -> DVec2 {
        let left = DVec2::new(-self.forward.y, self.forward.x);
        self.centre + self.forward * (along * self.half.x) + left * (across * self.half.y)
    }

    /// Whether a point lies in the rectangle, edges included.
    pub fn contains(&self, p: DVec2) -> bool {
        let d = p - self.centre;
        d.dot(self.forward).abs() <= self.half.x && d.perp_dot(self.forward).abs() <= self.half.y
    }

    /// Corners, counter-clockwise.
    pub fn corners(&self) -> [DVec2; 4] {
        [
            self.at(1.0, 1.0),
            self.at(-1.0, 1.0),
            self.at(-1.0, -1.0),
            self.at(1.0, -1.0),
        ]
    }

    /// Smallest and largest corner of the rectangle's bounds along x and y.
    pub fn bounds(&self) -> (DVec2, DVec2) {
        let left = DVec2::new(-self.forward.y, self.forward.x);
        let reach = self.forward.abs() * self.half.x + left.abs() * self.half.y;
        (self.centre - reach, self.centre + reach)
    }

    /// Whether the rectangle overlaps an upright square, by the four directions that can separate them.
    pub fn overlaps_square(&self, centre: DVec2, side: f64) -> bool {
        let half = 0.5 * side;
        let (low, high) = self.bounds();
        if (centre - DVec2::splat(half)).cmpge(high).any()
            || (centre + DVec2::splat(half)).cmple(low).any()
        {
            return false;
        }
        let offset = centre - self.centre;
        let reach = half * (self.forward.x.abs() + self.forward.y.abs());
        offset.dot(self.forward).abs() < self.half.x + reach
            && offset.perp_dot(self.forward).abs() < self.half.y + reach
    }

    /// Points that cover the rectangle, edges included, at most `spacing_m` apart.
    pub fn points(&self, spacing_m: f64) -> impl Iterator<Item = DVec2> + '_ {
        let steps = |half: f64| (libm::ceil(2.0 * half / spacing_m) as i32).max(1);
        let (along, across) = (steps(self.half.x), steps(self.half.y));
        (0..=along).flat_map(move |i| {
            (0..=across).map(move |j| {
                self.at(
                    2.0 * f64::from(i) / f64::from(along) - 1.0,
                    2.0 * f64::from(j) / f64::from(across) - 1.0,
                )
            })
        })
    }
}

/// z = height + slope . (x, y) about an origin, fitted to points.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GroundPlane {
    pub origin: DVec2,
    /// Height at `origin`, metres.
    pub height_m: f64,
    pub slope: DVec2,
}

impl GroundPlane {
    /// Least squares about the centroid; flat if the points do not span a plane. `None` without points.
    pub fn fit(points: &[DVec3]) -> Option<Self> {
        if points.is_empty() {
            return None;
        }
        let count = points.len() as f64;
        let mean = points.iter().fold(DVec3::ZERO, |sum, p| sum + *p) / count;
        let (mut xx, mut xy, mut yy, mut xz, mut yz) = (0.0, 0.0, 0.0, 0.0, 0.0);
        for p in points {
            let d = *p - mean;
            xx += d.x * d.x;
            xy += d.x * d.y;
            yy += d.y * d.y;
            xz += d.x * d.z;
            yz += d.y * d.z;
        }
        let determinant = xx * yy - xy * xy;
        // Relative: points on one line have no cross slope.
        let slope = if determinant > 1e-6 * (xx + yy) * (xx + yy) {
            DVec2::new(xz * yy - yz * xy, yz * xx - xz * xy) / determinant
        } else {
            DVec2::ZERO
        };
        Some(Self {
            origin: mean.truncate(),
            height_m: mean.z,
            slope,
        })
    }

    pub fn height_at(&self, p: DVec2) -> f64 {
        self.height_m + self.slope.dot(p - self.origin)
    }

    /// The pose of a cuboid that stands on this plane at `p` with the given heading: pitch and roll come from the plane.
    pub fn stand(&self, p: DVec2, heading_rad: f64, height_m: f64) -> Rigid {
        let up = DVec3::new(-self.slope.x, -self.slope.y, 1.0).normalize();
        let (sin, cos) = libm::sincos(heading_rad);
        let level = DVec3::new(cos, sin, self.slope.dot(DVec2::new(cos, sin)));
        let forward = level.normalize();
        let left = up.cross(forward);
        let rotation = DQuat::from_mat3(&DMat3::from_cols(forward, left, up)).normalize();
        Rigid::new(
            rotation,
            p.extend(self.height_at(p)) + up * (height_m * 0.5),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cuboid_on_a_slope_keeps_its_wheels_on_the_plane() {
        let slope = DVec2::new(0.05, -0.02);
        let points: Vec<_> = (0..36)
            .map(|i| DVec2::new(f64::from(i % 6), f64::from(i / 6)))
            .map(|p| p.extend(1.0 + slope.dot(p)))
            .collect();
        let plane = GroundPlane::fit(&points).unwrap();
        assert!((plane.slope - slope).length() < 1e-12);
        let size = DVec3::new(4.5, 1.9, 1.6);
        let at = DVec2::new(2.0, 3.0);
        let pose = plane.stand(at, 0.7, size.z);
        assert!((pose.heading_rad() - 0.7).abs() < 1e-12);
        for (x, y) in [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)] {
            let wheel = pose.point(DVec3::new(x, y, -1.0) * size * 0.5);
            let ground = 1.0 + slope.dot(wheel.truncate());
            assert!((wheel.z - ground).abs() < 1e-9, "{wheel} {ground}");
        }
    }

    #[test]
    fn points_cover_corners_and_spacing() {
        let footprint = Footprint::new(DVec2::new(1.0, 2.0), 0.3, DVec3::new(4.4, 1.8, 1.5));
        let points: Vec<_> = footprint.points(0.25).collect();
        for corner in footprint.corners() {
            assert!(points.iter().any(|p| (*p - corner).length() < 1e-12));
        }
        assert!(points.len() >= 18 * 8, "{}", points.len());
    }

    #[test]
    fn squares_overlap_where_points_of_both_do() {
        let footprint = Footprint::new(DVec2::new(0.3, -0.2), 0.6, DVec3::new(4.4, 1.8, 1.5));
        let inner: Vec<_> = footprint.points(0.02).collect();
        let mut overlapping = 0;
        for i in 0..1600 {
            let centre = DVec2::new(f64::from(i % 40), f64::from(i / 40)) * 0.15 - 3.0;
            let inside = inner
                .iter()
                .filter(|p| (**p - centre).abs().max_element() < 0.25)
                .count();
            let overlaps = footprint.overlaps_square(centre, 0.5);
            // A sliver may fall between the points.
            assert!(overlaps || inside == 0, "{centre}");
            let grown = footprint.grown(-0.02).overlaps_square(centre, 0.5 - 0.04);
            assert!(!grown || inside > 0, "{centre}");
            overlapping += u32::from(overlaps);
        }
        assert!((300..1200).contains(&overlapping), "{overlapping}");
    }

    #[test]
    fn collinear_points_give_no_cross_slope() {
        let line: Vec<_> = (0..5).map(|i| DVec3::new(f64::from(i), 0.0, 0.1)).collect();
        assert_eq!(GroundPlane::fit(&line).unwrap().slope, DVec2::ZERO);
        assert!(GroundPlane::fit(&[]).is_none());
    }
}
