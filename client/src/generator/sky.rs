//! Sun, sky and distant haze.

use glam::{DVec3, Vec2, Vec3};

use super::noise::{fractal, smoothstep};

/// Unit vector from the ground towards the sun: behind the ego vehicle and to its left, so that the road is lit.
pub(super) fn sun_direction() -> DVec3 {
    DVec3::new(-0.62, 0.34, 0.71).normalize()
}

/// Radiance of the sun on a surface facing it, relative to a white diffuser in the shade.
pub(super) const SUN: Vec3 = Vec3::new(2.35, 2.12, 1.75);
pub(super) const SKY_AMBIENT: Vec3 = Vec3::new(0.46, 0.54, 0.68);
pub(super) const GROUND_AMBIENT: Vec3 = Vec3::new(0.26, 0.245, 0.225);
const ZENITH: Vec3 = Vec3::new(0.15, 0.35, 0.80);
const HORIZON: Vec3 = Vec3::new(0.72, 0.82, 0.93);
const CLOUD: Vec3 = Vec3::new(1.25, 1.23, 1.2);
/// Distance over which haze takes 1 - 1/e of a surface's light.
const HAZE_M: f32 = 900.0;

/// Linear radiance of the sky in a unit direction.
pub(super) fn radiance(direction: Vec3, seed: u32) -> Vec3 {
    let up = direction.z.max(0.0);
    let clear = HORIZON.lerp(ZENITH, 1.0 - (1.0 - up).powi(4));
    // Clouds lie on a plane; near the horizon they would be finer than a pixel and fade into haze.
    let plane = Vec2::new(direction.x, direction.y) / (up + 0.12);
    let cover = fractal(
        plane * Vec2::new(1.0, 1.6),
        1.1,
        4,
        0.02,
        seed.wrapping_add(900),
    );
    let density = smoothstep(0.02, 0.42, cover) * smoothstep(0.02, 0.22, up);
    clear.lerp(CLOUD, 0.85 * density)
}

/// What a mirror facing the street sees in a direction, without tracing it: sky, a band of facades, the road.
pub(super) fn mirrored(direction: Vec3, seed: u32) -> Vec3 {
    let road = Vec3::new(0.13, 0.13, 0.135);
    let facade = Vec3::new(0.22, 0.19, 0.16);
    // Facades fill the view sideways up to 40 degrees, and almost nothing along the street.
    let sideways = direction.y.abs();
    let skyline = 0.03 + 0.55 * sideways * sideways;
    let above = smoothstep(skyline - 0.06, skyline + 0.06, direction.z);
    let below = smoothstep(-0.05, 0.03, direction.z);
    road.lerp(facade, below)
        .lerp(radiance(direction, seed), above)
}

/// Adds the light scattered between camera and surface.
pub(super) fn haze(surface: Vec3, distance_m: f32) -> Vec3 {
    surface.lerp(HORIZON, 1.0 - (-distance_m / HAZE_M).exp())
}
