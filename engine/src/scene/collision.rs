//! Whether two cuboids overlap: area of the intersection of their footprints, and their height ranges.

use glam::{DVec2, DVec3};

use super::footprint::Footprint;
use crate::camera::Rigid;

/// An oriented box that may not overlap another.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Occupied {
    pub local_from_cuboid: Rigid,
    pub size_m: DVec3,
}

impl Occupied {
    /// Whether a point of the local frame lies inside.
    pub fn contains(&self, p: DVec3) -> bool {
        let p = self.local_from_cuboid.inverse().point(p);
        p.abs().cmple(self.size_m * 0.5).all()
    }

    fn height_range(&self) -> (f64, f64) {
        let centre = self.local_from_cuboid.translation_m.z;
        (centre - self.size_m.z * 0.5, centre + self.size_m.z * 0.5)
    }

    /// Volume of the intersection in m^3, with boxes taken as upright prisms over their footprints.
    pub fn overlap_m3(&self, other: &Self) -> f64 {
        let (low_a, high_a) = self.height_range();
        let (low_b, high_b) = other.height_range();
        let height = high_a.min(high_b) - low_a.max(low_b);
        if height <= 0.0 {
            return 0.0;
        }
        let a = Footprint::of_cuboid(&self.local_from_cuboid, self.size_m);
        let b = Footprint::of_cuboid(&other.local_from_cuboid, other.size_m);
        height * intersection_area_m2(&a, &b)
    }

    /// Whether the boxes come closer to each other than `clearance_m` horizontally and overlap in height.
    pub fn collides(&self, other: &Self, clearance_m: f64) -> bool {
        let grown = Self {
            size_m: self.size_m + DVec3::new(2.0 * clearance_m, 2.0 * clearance_m, 0.0),
            ..*self
        };
        grown.overlap_m3(other) > 0.0
    }
}

/// Area of the intersection of two footprints, by clipping one against the other's edges (Sutherland and Hodgman, 1974).
pub fn intersection_area_m2(a: &Footprint, b: &Footprint) -> f64 {
    let reach = a.half.length() + b.half.length();
    if (a.centre - b.centre).length_squared() > reach * reach {
        return 0.0;
    }
    let mut polygon = Polygon::new(&a.corners());
    let clip = b.corners();
    for i in 0..4 {
        polygon = polygon.clipped(clip[i], clip[(i + 1) % 4]);
    }
    polygon.area_m2()
}

/// A convex polygon of at most 8 corners: a quadrilateral clipped by four half planes.
#[derive(Clone, Copy)]
struct Polygon {
    corners: [DVec2; 8],
    count: usize,
}

impl Polygon {
    fn new(corners: &[DVec2]) -> Self {
        let mut polygon = Self {
            corners: [DVec2::ZERO; 8],
            count: 0,
        };
        for corner in corners {
            polygon.push(*corner);
        }
        polygon
    }

    fn push(&mut self, corner: DVec2) {
        self.corners[self.count] = corner;
        self.count += 1;
    }

    /// Keeps what lies left of the line from `from` to `to`.
    fn clipped(&self, from: DVec2, to: DVec2) -> Self {
        let side = |p: DVec2| (to - from).perp_dot(p - from);
        let mut kept = Self::new(&[]);
        for i in 0..self.count {
            let (p, q) = (self.corners[i], self.corners[(i + 1) % self.count]);
            let (side_p, side_q) = (side(p), side(q));
            if side_p >= 0.0 {
                kept.push(p);
            }
            if (side_p > 0.0 && side_q < 0.0) || (side_p < 0.0 && side_q > 0.0) {
                kept.push(p + (q - p) * (side_p / (side_p - side_q)));
            }
        }
        kept
    }

    fn area_m2(&self) -> f64 {
        let mut twice = 0.0;
        for i in 0..self.count {
            twice += self.corners[i].perp_dot(self.corners[(i + 1) % self.count]);
        }
        twice.abs() * 0.5
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn inside(footprint: &Footprint, p: DVec2) -> bool {
        let d = p - footprint.centre;
        d.dot(footprint.forward).abs() <= footprint.half.x
            && d.perp_dot(footprint.forward).abs() <= footprint.half.y
    }

    fn counted_area(a: &Footprint, b: &Footprint) -> f64 {
        let steps = 400;
        let cell = DVec2::new(a.half.x, a.half.y) * 2.0 / f64::from(steps);
        let mut hits = 0u32;
        for i in 0..steps {
            for j in 0..steps {
                let fraction = |k: i32| (f64::from(k) + 0.5) * 2.0 / f64::from(steps) - 1.0;
                if inside(b, a.at(fraction(i), fraction(j))) {
                    hits += 1;
                }
            }
        }
        f64::from(hits) * cell.x * cell.y
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]
        #[test]
        fn area_agrees_with_counting(
            x in -4.0f64..4.0, y in -3.0f64..3.0, turn_a in -3.2f64..3.2, turn_b in -3.2f64..3.2,
        ) {
            let a = Footprint::new(DVec2::ZERO, turn_a, DVec3::new(4.5, 1.9, 1.5));
            let b = Footprint::new(DVec2::new(x, y), turn_b, DVec3::new(3.0, 2.4, 1.5));
            let exact = intersection_area_m2(&a, &b);
            prop_assert!((exact - intersection_area_m2(&b, &a)).abs() < 1e-9);
            prop_assert!((exact - counted_area(&a, &b)).abs() < 0.05, "{exact}");
        }
    }

    #[test]
    fn height_separates_and_clearance_joins() {
        let at = |x: f64, z: f64| Occupied {
            local_from_cuboid: Rigid::from_heading(0.0, DVec3::new(x, 0.0, z)),
            size_m: DVec3::new(4.0, 2.0, 1.5),
        };
        assert!(at(0.0, 0.0).collides(&at(3.9, 0.0), 0.0));
        assert!(!at(0.0, 0.0).collides(&at(4.1, 0.0), 0.0));
        assert!(at(0.0, 0.0).collides(&at(4.1, 0.0), 0.2));
        assert!(!at(0.0, 0.0).collides(&at(0.0, 1.6), 0.2));
        assert!((at(0.0, 0.0).overlap_m3(&at(2.0, 0.5)) - 2.0 * 2.0 * 1.0).abs() < 1e-9);
    }
}
