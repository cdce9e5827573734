//! Finishes of a car by position on its body: paint, glass, lamps, grille, plates, arches, tyres and rims.

use glam::Vec3;

use super::car::{AXLES, CarDesign, RIM, TYRE, UNDERSIDE};
use super::noise::hash;
use super::texture::Finish;

const GLASS: Finish = Finish {
    albedo: Vec3::new(0.018, 0.020, 0.023),
    mirror: 0.075,
    region: 1,
};
const BLACK_PLASTIC: Finish = Finish {
    albedo: Vec3::new(0.022, 0.022, 0.023),
    mirror: 0.01,
    region: 2,
};

/// Finish at `p` in the cuboid frame with unit normal `n`; symmetric in y.
pub(super) fn finish(design: &CarDesign, material: u16, p: Vec3, n: Vec3) -> Finish {
    match material {
        TYRE => Finish {
            albedo: Vec3::splat(0.020),
            mirror: 0.0,
            region: 3,
        },
        UNDERSIDE => Finish {
            albedo: Vec3::splat(0.015),
            mirror: 0.0,
            region: 2,
        },
        RIM => rim(design, p),
        _ => body(design, p, n),
    }
}

/// Five double spokes on a dark hub well.
fn rim(design: &CarDesign, p: Vec3) -> Finish {
    let axle = if p.x > 0.0 { AXLES[1] } else { AXLES[0] } * 0.5 * design.size_m.x;
    let radius = design.wheel_radius_m();
    let (dx, dz) = (p.x - axle, p.z + 0.5 * design.size_m.z - radius);
    let r = dx.hypot(dz) / radius;
    let sector = (dz.atan2(dx) / std::f32::consts::TAU * 5.0).rem_euclid(1.0) - 0.5;
    let spoke = sector.abs() * r < 0.11;
    if !(0.14..=0.60).contains(&r) || spoke {
        return Finish {
            albedo: Vec3::splat(0.42),
            mirror: 0.12,
            region: 4,
        };
    }
    Finish {
        albedo: Vec3::splat(0.03),
        mirror: 0.0,
        region: 5,
    }
}

fn body(design: &CarDesign, p: Vec3, n: Vec3) -> Finish {
    let size = design.size_m;
    let x = p.x / (0.5 * size.x);
    let y = p.y.abs() / (0.5 * size.y);
    let z = p.z / size.z + 0.5;
    if let Some(finish) = glass(design, x, p.y.abs(), z, n) {
        return finish;
    }
    if let Some(finish) = lower_body(design, x, y, z, p, n) {
        return finish;
    }
    if let Some(finish) = ends(design, x, y, z, p, n) {
        return finish;
    }
    let flank = n.y.abs() > 0.6 && z > 0.22 && z < design.shape.belt;
    let (albedo, region) = if flank && door_seam(design, x, size.x) {
        (design.paint * 0.25, 6)
    } else if flank && door_handle(design, p) {
        (Vec3::splat(0.05), 12)
    } else {
        (design.paint, 0)
    };
    Finish {
        albedo,
        mirror: 0.05,
        region,
    }
}

/// A dark handle at the rear of each door, 16 cm long.
fn door_handle(design: &CarDesign, p: Vec3) -> bool {
    let belt_m = (design.shape.belt - 0.5) * design.size_m.z;
    let rear_edge_m = 0.5 * design.size_m.x * design.shape.pillars[0];
    let doors = [
        rear_edge_m + 0.14,
        rear_edge_m - 0.26 * design.size_m.x * 0.5 - 0.30,
    ];
    (p.z - belt_m + 0.12).abs() < 0.018 && doors.iter().any(|x| (p.x - x).abs() < 0.08)
}

fn door_seam(design: &CarDesign, x: f32, length: f32) -> bool {
    let half = 0.010 / (0.5 * length);
    let ends = [design.shape.windscreen.1 - 0.12, -0.50];
    ends.iter()
        .chain(design.shape.pillars)
        .any(|seam| (x - seam).abs() < half)
}

fn glass(design: &CarDesign, x: f32, y_m: f32, z: f32, n: Vec3) -> Option<Finish> {
    let shape = design.shape;
    let height = design.size_m.z;
    if z < shape.belt + 0.015 {
        return None;
    }
    let within = |range: (f32, f32)| x > range.0 && x < range.1;
    let roof = design.top(x);
    let side = n.y.abs() > 0.62
        && within(shape.side_glass)
        && z < roof - 0.105 / height
        && !shape
            .pillars
            .iter()
            .any(|pillar| (x - pillar).abs() < 0.022);
    let facing_end = n.y.abs() < 0.62 && y_m < design.half_width_m(x, z) * 0.955 - 0.07;
    let end = facing_end && (within(shape.windscreen) || within(shape.rear_glass));
    (side || end).then_some(GLASS)
}

/// Wheel arches, sills and bumper skirts.
fn lower_body(design: &CarDesign, x: f32, y: f32, z: f32, p: Vec3, n: Vec3) -> Option<Finish> {
    let size = design.size_m;
    let radius = design.wheel_radius_m();
    let height_m = p.z + 0.5 * size.z;
    let in_arch = AXLES
        .iter()
        .any(|axle| (p.x - axle * 0.5 * size.x).hypot(height_m - radius) < radius * 1.14);
    if in_arch && y > 0.72 && n.y.abs() > 0.25 {
        return Some(Finish {
            region: 7,
            ..BLACK_PLASTIC
        });
    }
    let skirt = if x.abs() > 0.9 { 0.235 } else { 0.19 };
    (z < skirt).then_some(BLACK_PLASTIC)
}

/// Lamps, grille and number plates at both ends.
fn ends(design: &CarDesign, x: f32, y: f32, z: f32, p: Vec3, n: Vec3) -> Option<Finish> {
    let front = x > 0.0;
    if x.abs() < 0.88 || n.x.abs() < 0.25 {
        return None;
    }
    let plate = p.y.abs() < 0.26
        && (p.z + 0.5 * design.size_m.z - if front { 0.47 } else { 0.62 }).abs() < 0.06;
    if plate && x.abs() > 0.95 {
        return Some(number_plate(design, p));
    }
    let lamp_z = if front { (0.415, 0.50) } else { (0.46, 0.60) };
    if y > 0.56 && y < 0.93 && z > lamp_z.0 && z < lamp_z.1 {
        let albedo = if front {
            Vec3::new(0.62, 0.64, 0.66)
        } else {
            Vec3::new(0.22, 0.004, 0.006)
        };
        return Some(Finish {
            albedo,
            mirror: 0.06,
            region: 8,
        });
    }
    let grille = front && y < 0.46 && z > 0.405 && z < 0.475;
    let intake = front && y < 0.70 && z > 0.245 && z < 0.315;
    (grille || intake).then_some(Finish {
        region: 9,
        ..BLACK_PLASTIC
    })
}

fn number_plate(design: &CarDesign, p: Vec3) -> Finish {
    // Strokes depend on |y| so that the car stays mirror-symmetric.
    let (column, row) = ((p.y.abs() / 0.021) as u32, ((p.z + 2.0) / 0.026) as u32);
    let ink =
        (1..11).contains(&column) && column % 4 != 3 && hash(column, row, design.seed) & 1 == 1;
    let albedo = Vec3::splat(if ink { 0.12 } else { 0.66 });
    Finish {
        albedo,
        mirror: 0.0,
        region: if ink { 10 } else { 11 },
    }
}
