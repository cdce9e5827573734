//! Which part of an object the camera would see, by sight lines against boxes and blocked cells.

use glam::DVec3;

use super::collision::Occupied;
use super::valid_region::ValidRegion;

/// Fraction of sight lines from `eye` to points of `object` that no obstacle cuts.
pub(super) fn clear_fraction(
    eye: DVec3,
    object: &Occupied,
    obstacles: &[Occupied],
    region: &ValidRegion,
) -> f64 {
    let mut clear = 0u32;
    let mut total = 0u32;
    for x in [-0.7, 0.0, 0.7] {
        for y in [-0.7, 0.0, 0.7] {
            for z in [-0.4, 0.5] {
                let target = object
                    .local_from_cuboid
                    .point(DVec3::new(x, y, z) * object.size_m * 0.5);
                total += 1;
                let cut = obstacles.iter().any(|o| cuts(o, eye, target));
                if !cut && !region.blocks_sight(eye, target) {
                    clear += 1;
                }
            }
        }
    }
    f64::from(clear) / f64::from(total)
}

/// Whether the segment passes through the box (slab test in the box's frame).
fn cuts(obstacle: &Occupied, from: DVec3, to: DVec3) -> bool {
    let cuboid_from_local = obstacle.local_from_cuboid.inverse();
    let (a, b) = (cuboid_from_local.point(from), cuboid_from_local.point(to));
    let half = obstacle.size_m * 0.5;
    let (mut enter, mut leave) = (0.0f64, 1.0f64);
    for axis in 0..3 {
        let (origin, step) = (a[axis], b[axis] - a[axis]);
        if step.abs() < 1e-12 {
            if origin.abs() > half[axis] {
                return false;
            }
            continue;
        }
        let (t0, t1) = ((-half[axis] - origin) / step, (half[axis] - origin) / step);
        enter = enter.max(t0.min(t1));
        leave = leave.min(t0.max(t1));
    }
    enter < leave
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Rigid;
    use glam::DVec2;

    #[test]
    fn a_car_in_front_hides_the_one_behind() {
        let car = |x: f64, y: f64| Occupied {
            local_from_cuboid: Rigid::from_heading(0.0, DVec3::new(x, y, 0.8)),
            size_m: DVec3::new(4.5, 1.9, 1.6),
        };
        let region = ValidRegion::unseen(DVec2::ZERO, 0.5, 1, 1);
        let eye = DVec3::new(0.0, 0.0, 1.2);
        let fraction = |y: f64| clear_fraction(eye, &car(20.0, 0.0), &[car(10.0, y)], &region);
        assert_eq!(fraction(0.0), 0.0);
        assert_eq!(fraction(4.0), 1.0);
        assert!(
            fraction(1.2) > 0.2 && fraction(1.2) < 0.9,
            "{}",
            fraction(1.2)
        );
        assert_eq!(
            clear_fraction(eye, &car(10.0, 0.0), &[car(20.0, 0.0)], &region),
            1.0
        );
    }
}
