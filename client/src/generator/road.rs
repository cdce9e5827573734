//! The plane z = 0: asphalt with wear and markings between the kerbs, grass outside.

use glam::{Vec2, Vec3};

use super::noise::{fractal, smoothstep, stripe, stripes, unit, value};
use super::street::ROAD_HALF_WIDTH_M;
use super::texture::{Finish, Point, matt};

/// Finish of the ground plane at a point.
pub(super) fn ground(point: &Point, seed: u32) -> Finish {
    let p = Vec2::new(point.position.x, point.position.y);
    let extent = Vec2::new(point.extent.x, point.extent.y);
    if p.y.abs() > ROAD_HALF_WIDTH_M + 0.1 {
        let tone = fractal(p, 3.0, 4, extent.max_element(), seed ^ 0x51);
        return matt(Vec3::new(0.10, 0.15, 0.05) * (1.0 + 0.5 * tone));
    }
    let asphalt = asphalt(p, extent, seed);
    let wear = 0.78 + 0.22 * fractal(p, 0.35, 3, extent.max_element(), seed ^ 0x77);
    let paint = markings(p, extent) * wear.clamp(0.0, 1.0);
    matt(asphalt.lerp(Vec3::new(0.66, 0.66, 0.63), paint))
}

fn asphalt(p: Vec2, extent: Vec2, seed: u32) -> Vec3 {
    // The footprint is long in x at grazing angles: several taps along it keep the lateral detail.
    let taps = (extent.x / extent.y.max(0.01)).clamp(1.0, 4.0) as u32;
    let width = extent.y.max(extent.x / taps as f32);
    let mut grain = 0.0;
    for tap in 0..taps {
        let offset = ((tap as f32 + 0.5) / taps as f32 - 0.5) * extent.x;
        grain += fractal(p + Vec2::new(offset, 0.0), 0.22, 4, width, seed ^ 0x11);
    }
    grain /= taps as f32;
    let broad = extent.max_element();
    let patches = fractal(p * Vec2::new(0.45, 1.0), 2.6, 4, broad, seed ^ 0x22);
    let tyres = [-1.0_f32, 1.0]
        .iter()
        .flat_map(|lane| [-0.75_f32, 0.75].map(|track| (p.y.abs() - 1.75 - track) * lane))
        .map(|d| (-(d / 0.28) * (d / 0.28)).exp())
        .sum::<f32>();
    let mut albedo = 0.165 * (1.0 + 0.40 * grain + 0.22 * patches - 0.05 * tyres);
    albedo *= 1.0 - 0.42 * repair(p, extent, seed);
    albedo *= 1.0 - 0.55 * crack(p, extent, seed);
    albedo *= 1.0 - 0.5 * stain(p, broad, seed);
    Vec3::new(1.0, 0.985, 0.95) * albedo
}

/// Darker rectangles where the road was opened and closed again.
fn repair(p: Vec2, extent: Vec2, seed: u32) -> f32 {
    const CELL_M: f32 = 11.0;
    let cell = (p.x / CELL_M).floor();
    let draw = |k: u32| unit(cell as i32 as u32, k, seed ^ 0x33);
    if draw(0) < 0.3 {
        return 0.0;
    }
    let x0 = (cell + 0.1 + 0.3 * draw(1)) * CELL_M;
    let y0 = -5.0 + 8.0 * draw(2);
    stripe(p.x, x0, x0 + 2.0 + 3.5 * draw(3), extent.x)
        * stripe(p.y, y0, y0 + 0.8 + 1.6 * draw(4), extent.y)
}

/// Thin dark lines that wander along the road.
fn crack(p: Vec2, extent: Vec2, seed: u32) -> f32 {
    let mut total = 0.0;
    for line in 0..3_u32 {
        let base = -4.2 + 3.6 * line as f32;
        let centre = base
            + 0.9 * value(Vec2::new(p.x * 0.22, line as f32 * 7.0), seed ^ 0x44)
            + 0.14 * value(Vec2::new(p.x * 1.9, line as f32 * 5.0), seed ^ 0x45);
        let open = smoothstep(
            -0.1,
            0.3,
            value(Vec2::new(p.x * 0.11, line as f32 * 3.0), seed ^ 0x46),
        );
        total += open
            * stripe(
                p.y,
                centre - 0.02,
                centre + 0.02,
                extent.y + 0.35 * extent.x,
            );
    }
    total.min(1.0)
}

fn stain(p: Vec2, width: f32, seed: u32) -> f32 {
    // Oil drips where cars park and in the middle of lanes.
    let near = (-((p.y.abs() - 4.6) / 0.7).powi(2)).exp()
        + 0.6 * (-((p.y.abs() - 1.75) / 0.35).powi(2)).exp();
    let blot = fractal(p, 1.3, 3, width, seed ^ 0x55);
    near.min(1.0) * smoothstep(0.12, 0.4, blot)
}

/// Coverage of road paint: a dashed centre line, edge lines, a zebra crossing and arrows.
fn markings(p: Vec2, e: Vec2) -> f32 {
    let dashes = stripes(p.x / 6.0, 0.5, e.x / 6.0) * stripe(p.y, -0.07, 0.07, e.y);
    let edges = stripe(p.y.abs(), 3.42, 3.54, e.y);
    let bays = stripes((p.x - 2.0) / 6.2, 0.1 / 6.2, e.x / 6.2) * stripe(p.y.abs(), 3.54, 5.6, e.y);
    let mut paint = dashes.max(edges).max(bays);
    for crossing in [46.0_f32, 128.0] {
        let inside = stripe(p.x, crossing - 0.6, crossing + 3.6, e.x);
        let zebra =
            stripe(p.x, crossing, crossing + 3.0, e.x) * stripes(p.y / 1.0 + 0.25, 0.5, e.y);
        let stop = stripe(p.x, crossing - 1.6, crossing - 1.2, e.x) * stripe(p.y, -3.4, 0.0, e.y);
        paint = (paint * (1.0 - inside))
            .max(zebra * stripe(p.y, -5.2, 5.2, e.y))
            .max(stop);
    }
    for (tip, lane) in [(27.0_f32, -1.75_f32), (72.0, -1.75), (104.0, -1.75)] {
        paint = paint.max(arrow(p - Vec2::new(tip, lane), e));
    }
    paint
}

/// An arrow pointing along +x with its tip at the origin.
fn arrow(q: Vec2, e: Vec2) -> f32 {
    let shaft = stripe(q.x, -4.0, -1.4, e.x) * stripe(q.y, -0.09, 0.09, e.y);
    let half = 0.42 * (-q.x / 1.6).clamp(0.0, 1.0);
    let head = stripe(q.x, -1.6, 0.0, e.x) * stripe(q.y, -half, half, e.y + 0.26 * e.x);
    shaft.max(head)
}
