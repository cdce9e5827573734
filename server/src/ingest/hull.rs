//! Convex outlines of cuboids in an image.

use backlot_engine::camera::{Camera, NEAR_M, Rigid};
use glam::{DVec2, DVec3};

/// Projections are held within this many pixels, so that a corner beside the camera does not overflow a raster.
const FAR_PX: f64 = 1e5;

/// Convex polygon of the near-clipped cuboid in pixels, counter-clockwise in image axes; empty if it is wholly nearer than
/// the near plane. May lie outside the image.
pub(super) fn cuboid_hull(
    camera: &Camera,
    camera_from_cuboid: &Rigid,
    size_m: DVec3,
) -> Vec<DVec2> {
    let corners = corners(camera_from_cuboid, size_m);
    let mut points = Vec::with_capacity(24);
    for a in 0..8usize {
        for bit in [1, 2, 4] {
            let b = a | bit;
            if b != a {
                clip_edge(corners[a], corners[b], &mut points);
            }
        }
    }
    convex_hull(project(camera, &points))
}

/// Corner `i` has +x, +y, +z where bits 0, 1, 2 of `i` are set.
pub(super) fn corners(target_from_cuboid: &Rigid, size_m: DVec3) -> [DVec3; 8] {
    std::array::from_fn(|i| {
        let sign = |bit: usize| if i & bit == 0 { -0.5 } else { 0.5 };
        target_from_cuboid.point(size_m * DVec3::new(sign(1), sign(2), sign(4)))
    })
}

fn clip_edge(a: DVec3, b: DVec3, out: &mut Vec<DVec3>) {
    match (a.z >= NEAR_M, b.z >= NEAR_M) {
        (false, false) => {}
        (true, true) => out.extend([a, b]),
        (true, false) => out.extend([a, at_near(a, b)]),
        (false, true) => out.extend([at_near(b, a), b]),
    }
}

fn at_near(inside: DVec3, outside: DVec3) -> DVec3 {
    let fraction = (inside.z - NEAR_M) / (inside.z - outside.z);
    let mut point = inside.lerp(outside, fraction);
    point.z = NEAR_M;
    point
}

fn project(camera: &Camera, points: &[DVec3]) -> Vec<DVec2> {
    let limit = DVec2::splat(FAR_PX);
    points
        .iter()
        .filter_map(|&p| camera.project(p))
        .map(|p| p.clamp(-limit, limit))
        .collect()
}

/// Andrew's monotone chain.
pub(super) fn convex_hull(mut points: Vec<DVec2>) -> Vec<DVec2> {
    points.sort_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
    points.dedup();
    if points.len() < 3 {
        return points;
    }
    let mut hull: Vec<DVec2> = Vec::with_capacity(2 * points.len());
    let mut half = |points: &mut dyn Iterator<Item = DVec2>| {
        let start = hull.len();
        for p in points {
            while hull.len() >= start + 2 {
                let (a, b) = (hull[hull.len() - 2], hull[hull.len() - 1]);
                if (b - a).perp_dot(p - b) > 0.0 {
                    break;
                }
                hull.pop();
            }
            hull.push(p);
        }
        hull.pop();
    };
    half(&mut points.iter().copied());
    half(&mut points.iter().rev().copied());
    hull
}

/// Twice-signed-area formula, positive for hulls made here; pixels squared.
pub(super) fn area(polygon: &[DVec2]) -> f64 {
    let n = polygon.len();
    (0..n)
        .map(|i| polygon[i].perp_dot(polygon[(i + 1) % n]))
        .sum::<f64>()
        .abs()
        / 2.0
}

/// Bounds of a polygon: (min, max); `None` if it is empty.
pub(super) fn bounds(polygon: &[DVec2]) -> Option<(DVec2, DVec2)> {
    let first = *polygon.first()?;
    Some(
        polygon
            .iter()
            .fold((first, first), |(lo, hi), &p| (lo.min(p), hi.max(p))),
    )
}

/// Whether a point lies in a convex polygon, its edges included.
pub(super) fn contains(polygon: &[DVec2], point: DVec2) -> bool {
    let n = polygon.len();
    (0..n).all(|i| (polygon[(i + 1) % n] - polygon[i]).perp_dot(point - polygon[i]) >= 0.0)
}

/// Calls `visit(row, columns)` for the pixels whose centres lie inside a convex polygon, within `width` x `height`.
pub(super) fn raster(
    polygon: &[DVec2],
    width: u32,
    height: u32,
    mut visit: impl FnMut(usize, std::ops::Range<usize>),
) {
    let Some((lo, hi)) = bounds(polygon) else {
        return;
    };
    let first = (lo.y - 0.5).ceil().max(0.0) as usize;
    let end = ((hi.y - 0.5).floor() + 1.0).clamp(0.0, f64::from(height)) as usize;
    for row in first..end {
        let Some((left, right)) = crossings(polygon, row as f64 + 0.5) else {
            continue;
        };
        let start = (left - 0.5).ceil().max(0.0) as usize;
        let stop = ((right - 0.5).floor() + 1.0).clamp(0.0, f64::from(width)) as usize;
        if start < stop {
            visit(row, start..stop);
        }
    }
}

/// Where the horizontal line at `y` enters and leaves a convex polygon.
fn crossings(polygon: &[DVec2], y: f64) -> Option<(f64, f64)> {
    let mut span: Option<(f64, f64)> = None;
    for i in 0..polygon.len() {
        let (a, b) = (polygon[i], polygon[(i + 1) % polygon.len()]);
        if (a.y <= y) == (b.y <= y) {
            continue;
        }
        let x = a.x + (b.x - a.x) * (y - a.y) / (b.y - a.y);
        span = Some(span.map_or((x, x), |(l, r)| (l.min(x), r.max(x))));
    }
    span
}

#[cfg(test)]
mod tests {
    use super::*;
    use backlot_engine::camera::Distortion;
    use glam::DQuat;

    fn camera() -> Camera {
        Camera {
            width: 100,
            height: 80,
            focal_px: DVec2::splat(100.0),
            principal_px: DVec2::new(50.0, 40.0),
            distortion: Distortion::None,
        }
    }

    #[test]
    fn hull_of_a_cuboid_ahead_is_its_near_face() {
        let pose = Rigid::new(DQuat::IDENTITY, DVec3::new(0.0, 0.0, 11.0));
        let hull = cuboid_hull(&camera(), &pose, DVec3::new(2.0, 2.0, 2.0));
        let (lo, hi) = bounds(&hull).unwrap();
        assert!((lo - DVec2::new(40.0, 30.0)).length() < 1e-9, "{lo}");
        assert!((hi - DVec2::new(60.0, 50.0)).length() < 1e-9, "{hi}");
        assert!((area(&hull) - 400.0).abs() < 1e-6);
        let mut pixels = 0;
        raster(&hull, 100, 80, |_, columns| pixels += columns.len());
        assert_eq!(pixels, 400);
        let inside = |x: f64, y: f64| contains(&hull, DVec2::new(x, y));
        assert!(inside(50.0, 40.0) && inside(41.0, 49.0));
        assert!(!inside(39.0, 40.0) && !inside(50.0, 51.0));
    }

    #[test]
    fn a_cuboid_that_reaches_behind_the_camera_is_clipped() {
        let pose = Rigid::new(DQuat::IDENTITY, DVec3::new(1.5, 0.0, 0.0));
        let hull = cuboid_hull(&camera(), &pose, DVec3::new(2.0, 2.0, 8.0));
        let mut columns_seen = [false; 100];
        raster(&hull, 100, 80, |_, c| columns_seen[c].fill(true));
        // Its far left edge is at x = 0.5 m, z = 4 m.
        assert!(columns_seen[99] && columns_seen[63] && !columns_seen[61]);
        let behind = Rigid::new(DQuat::IDENTITY, DVec3::new(0.0, 0.0, -9.0));
        assert!(cuboid_hull(&camera(), &behind, DVec3::splat(2.0)).is_empty());
    }
}
