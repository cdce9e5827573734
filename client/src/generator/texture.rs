//! Procedural finishes of the street: linear albedo and gloss as functions of position, filtered to a pixel's footprint.

use glam::{Vec2, Vec3};

use super::facade::Building;
use super::noise::{fractal, hash, smoothstep, stripe, stripes, unit, value};
use super::street::Material;

/// Optical properties of a surface point.
#[derive(Clone, Copy, Debug)]
pub(super) struct Finish {
    /// Linear RGB in 0..1.
    pub(super) albedo: Vec3,
    /// Mirror reflectance at normal incidence; 0 is matt.
    pub(super) mirror: f32,
    /// Separates areas of one mesh that differ in colour, so that their borders are anti-aliased.
    pub(super) region: u16,
}

/// A point on a static surface: street coordinates, unit normal, and the pixel's extent along each axis, all metres.
#[derive(Clone, Copy, Debug)]
pub(super) struct Point {
    pub(super) position: Vec3,
    pub(super) normal: Vec3,
    pub(super) extent: Vec3,
}

pub(super) fn matt(albedo: Vec3) -> Finish {
    Finish {
        albedo,
        mirror: 0.0,
        region: 0,
    }
}

/// Finish of everything else that does not move.
pub(super) fn fixed(
    material: Material,
    point: &Point,
    buildings: &[Building],
    seed: u32,
) -> Finish {
    let p = point.position;
    let width = point.extent.max_element();
    let building = |index: u16| &buildings[index as usize];
    match material {
        Material::Pavement => pavement(point, seed),
        Material::Kerb => {
            let joint = stripes(p.x, 0.02, point.extent.x);
            let tone = unit(p.x.floor() as i32 as u32, 3, seed) - 0.5;
            matt(Vec3::splat(0.36 * (1.0 + 0.2 * tone) * (1.0 - 0.5 * joint)))
        }
        Material::Wall(index) => wall(building(index), point),
        Material::Trim(index) => {
            let dirt = fractal(across(point), 0.8, 3, width, building(index).seed);
            matt(building(index).trim * (1.0 + 0.14 * dirt))
        }
        Material::Pane(index) => pane(building(index), point),
        Material::ShopPane(index) => shop_pane(building(index), point),
        Material::Door(index) => {
            let uv = across(point);
            let panel =
                stripes(uv.x * 1.8, 0.12, width * 1.8).max(stripes(uv.y * 1.3, 0.1, width * 1.3));
            matt(building(index).accent * (1.5 - 0.6 * panel) + Vec3::splat(0.02))
        }
        Material::Sign(index) => sign(building(index), point),
        Material::Roof(index) => {
            let rows = stripes(p.z * 2.6, 0.18, point.extent.z * 2.6);
            let tone = fractal(
                Vec2::new(p.x + p.y, p.z * 2.0),
                0.9,
                3,
                width,
                building(index).seed,
            );
            matt(Vec3::new(0.24, 0.105, 0.07) * (1.0 + 0.3 * tone) * (1.0 - 0.4 * rows))
        }
        Material::Bark => {
            let tone = fractal(
                Vec2::new((p.x + p.y) * 3.0, p.z),
                0.22,
                3,
                width,
                seed ^ 0x91,
            );
            matt(Vec3::new(0.15, 0.11, 0.08) * (1.0 + 0.6 * tone))
        }
        Material::Leaves(kind) => leaves(point, kind, seed),
        Material::Metal => Finish {
            mirror: 0.03,
            ..matt(Vec3::new(0.13, 0.14, 0.15))
        },
        Material::Lamp => matt(Vec3::splat(0.55)),
        Material::RoadSign => road_sign(point),
        Material::Bin => {
            let bands = stripes(p.z * 5.0, 0.3, point.extent.z * 5.0);
            matt(Vec3::new(0.05, 0.13, 0.08) * (1.0 + 0.7 * bands))
        }
        Material::Hill => {
            let tone = fractal(Vec2::new(p.x + p.y, 2.0 * p.z), 18.0, 4, width, seed ^ 0xa1);
            matt(Vec3::new(0.10, 0.15, 0.08) * (1.0 + 0.5 * tone))
        }
    }
}

/// Coordinates in a vertical surface: horizontal position, height.
fn across(point: &Point) -> Vec2 {
    let along = if point.normal.y.abs() > point.normal.x.abs() {
        point.position.x
    } else {
        point.position.y
    };
    Vec2::new(along, point.position.z)
}

fn across_extent(point: &Point) -> Vec2 {
    let along = if point.normal.y.abs() > point.normal.x.abs() {
        point.extent.x
    } else {
        point.extent.y
    };
    Vec2::new(along, point.extent.z)
}

fn pavement(point: &Point, seed: u32) -> Finish {
    let p = Vec2::new(point.position.x, point.position.y);
    let e = Vec2::new(point.extent.x, point.extent.y);
    const SLAB_M: f32 = 0.6;
    let joints =
        stripes(p.x / SLAB_M, 0.03, e.x / SLAB_M).max(stripes(p.y / SLAB_M, 0.03, e.y / SLAB_M));
    let slab = (p / SLAB_M).floor();
    let keep = 1.0 - smoothstep(0.3, 1.0, e.max_element() / SLAB_M);
    let tone = (unit(slab.x as i32 as u32, slab.y as i32 as u32, seed ^ 0x61) - 0.5) * keep;
    let dirt = fractal(p, 1.1, 5, e.max_element(), seed ^ 0x62);
    matt(Vec3::new(0.37, 0.355, 0.33) * (1.0 + 0.28 * tone + 0.22 * dirt) * (1.0 - 0.45 * joints))
}

fn wall(building: &Building, point: &Point) -> Finish {
    let (uv, e) = (across(point), across_extent(point));
    let width = e.max_element();
    let stains = fractal(
        uv * Vec2::new(1.0, 0.45),
        1.9,
        5,
        width,
        building.seed ^ 0x71,
    );
    // Rain splash darkens the foot of a wall.
    let foot = 1.0 - 0.22 * (-(uv.y - 0.1).max(0.0) / 0.5).exp();
    if !building.brick {
        let grain = fractal(uv, 0.14, 2, width, building.seed ^ 0x72);
        return matt(building.wall * (1.0 + 0.22 * stains + 0.10 * grain) * foot);
    }
    const BRICK: Vec2 = Vec2::new(0.30, 0.105);
    let row = (uv.y / BRICK.y).floor();
    let u = uv.x / BRICK.x + 0.5 * (row.rem_euclid(2.0));
    let mortar = stripes(u, 0.07, e.x / BRICK.x).max(stripes(uv.y / BRICK.y, 0.17, e.y / BRICK.y));
    let keep = 1.0 - smoothstep(0.4, 1.2, width / BRICK.y);
    let tone = (unit(u.floor() as i32 as u32, row as i32 as u32, building.seed) - 0.5) * keep;
    let brick = building.wall * (1.0 + 0.6 * tone + 0.30 * stains);
    matt(brick.lerp(Vec3::new(0.40, 0.37, 0.33), mortar * 0.8) * foot)
}

/// A window pane: a dim room, sometimes curtains, and a mirror of the street.
fn pane(building: &Building, point: &Point) -> Finish {
    let uv = across(point);
    let room = hash(
        (uv.x / 2.7).floor() as i32 as u32,
        (uv.y / 3.05).floor() as i32 as u32,
        building.seed,
    );
    let curtain = 0.5 + 0.5 * value(Vec2::new(uv.x * 9.0, 0.5), room);
    let inside = match room % 3 {
        0 => Vec3::new(0.30, 0.28, 0.25) * (0.55 + 0.45 * curtain),
        1 => Vec3::new(0.025, 0.027, 0.03),
        _ => Vec3::new(0.05, 0.048, 0.045),
    };
    Finish {
        albedo: inside,
        mirror: 0.09,
        region: 0,
    }
}

fn shop_pane(building: &Building, point: &Point) -> Finish {
    let (uv, e) = (across(point), across_extent(point));
    let goods = fractal(
        uv * Vec2::new(1.0, 0.8),
        0.55,
        2,
        e.max_element(),
        building.seed ^ 0x81,
    );
    let tint = building
        .accent
        .lerp(Vec3::new(0.30, 0.24, 0.16), smoothstep(-0.2, 0.3, goods));
    let shelf = stripe(uv.y, 0.65, 1.25 + 0.4 * goods, e.y);
    Finish {
        albedo: (Vec3::splat(0.03) + 0.6 * tint * shelf).min(Vec3::ONE),
        mirror: 0.08,
        region: 0,
    }
}

/// A shop sign with a row of letter-like strokes.
fn sign(building: &Building, point: &Point) -> Finish {
    let (uv, e) = (across(point), across_extent(point));
    const LETTER_M: f32 = 0.30;
    // Letters run from left to right for someone in the street.
    let uv = if point.normal.y > 0.5 || point.normal.x < -0.5 {
        Vec2::new(-uv.x, uv.y)
    } else {
        uv
    };
    let cell = (uv.x / LETTER_M).floor();
    let letter = hash(cell as i32 as u32, building.seed, 5);
    let word_drawn = hash((cell / 13.0).floor() as i32 as u32, building.seed, 6);
    let word = !letter.is_multiple_of(7) && !word_drawn.is_multiple_of(3);
    let (u, v) = (uv.x - cell * LETTER_M, uv.y - 2.90);
    let upright =
        stripe(u, 0.04, 0.09, e.x).max(stripe(u, 0.18, 0.23, e.x) * (letter >> 4 & 1) as f32);
    let bars = [0.0_f32, 0.11, 0.24]
        .iter()
        .enumerate()
        .map(|(i, z)| stripe(v, *z, z + 0.05, e.y) * (letter >> (5 + i) & 1) as f32)
        .fold(0.0, f32::max);
    let stroke = (upright * stripe(v, 0.0, 0.29, e.y)).max(bars * stripe(u, 0.04, 0.23, e.x));
    let ink = if word { stroke } else { 0.0 };
    matt((building.accent * 1.2).lerp(Vec3::new(0.72, 0.68, 0.55), ink))
}

fn leaves(point: &Point, kind: u16, seed: u32) -> Finish {
    let p = point.position;
    let width = point.extent.max_element();
    let uv = Vec2::new(p.x + 0.7 * p.z, p.y - 0.6 * p.z);
    let clumps = fractal(uv, 0.55, 3, width, seed ^ 0xb1);
    let side = fractal(Vec2::new(p.x - p.y, p.z * 1.3), 0.40, 3, width, seed ^ 0xb2);
    let tint = [
        Vec3::new(0.085, 0.16, 0.035),
        Vec3::new(0.12, 0.17, 0.04),
        Vec3::new(0.06, 0.13, 0.045),
    ][kind as usize % 3];
    let twigs = fractal(uv + Vec2::splat(9.0), 0.16, 2, width, seed ^ 0xb3);
    matt(tint * (1.0 + 0.75 * clumps + 0.6 * side + 0.9 * twigs).max(0.12))
}

/// A round sign: red ring, white middle, dark bar.
fn road_sign(point: &Point) -> Finish {
    let v = point.position.z - 2.58;
    let side = point.position.y.abs() - 6.1;
    let radius = v.hypot(side);
    let ring = smoothstep(0.225, 0.24, radius);
    let bar = stripe(v, -0.05, 0.05, point.extent.z) * stripe(side, -0.15, 0.15, point.extent.y);
    let face = Vec3::splat(0.72).lerp(Vec3::splat(0.05), bar);
    matt(face.lerp(Vec3::new(0.50, 0.03, 0.03), ring))
}
