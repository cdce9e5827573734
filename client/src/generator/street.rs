//! Layout of everything that does not move: pavements, buildings, trees, lamp posts, hills. The road itself is the plane z = 0.

use glam::{Vec2, Vec3};

use super::bvh::Mesh;
use super::facade::{Building, add_building};
use super::mesh::MeshBuilder;
use super::noise::{unit, value};

/// Half width of the asphalt between the kerbs.
pub(super) const ROAD_HALF_WIDTH_M: f32 = 5.7;
const KERB_WIDTH_M: f32 = 0.16;
const PAVEMENT_Z_M: f32 = 0.13;
/// Distance of the facades from the middle of the street.
pub(super) const FACADE_Y_M: f32 = 9.0;
/// Where the street begins along x.
pub(super) const START_M: f32 = -45.0;
/// Where it ends at the least, and how far beyond the last frame; a building closes it there.
const LEAST_END_M: f32 = 178.0;
const AHEAD_M: f32 = 78.0;

/// What a static triangle is made of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Material {
    Pavement,
    Kerb,
    /// The rest of a building, with its index.
    Wall(u16),
    Pane(u16),
    Trim(u16),
    Door(u16),
    ShopPane(u16),
    Sign(u16),
    Roof(u16),
    Bark,
    Leaves(u16),
    Metal,
    Lamp,
    RoadSign,
    Bin,
    Hill,
}

/// The static part of the street, ready for tracing.
#[derive(Debug)]
pub(super) struct Street {
    pub(super) mesh: Mesh,
    pub(super) materials: Vec<Material>,
    pub(super) buildings: Vec<Building>,
}

/// Collects triangles under materials.
#[derive(Debug, Default)]
pub(super) struct StreetBuilder {
    pub(super) mesh: MeshBuilder,
    materials: Vec<Material>,
}

impl StreetBuilder {
    /// Index of a material for the mesh.
    pub(super) fn material(&mut self, material: Material) -> u16 {
        let known = self.materials.iter().position(|&m| m == material);
        known.unwrap_or_else(|| {
            self.materials.push(material);
            self.materials.len() - 1
        }) as u16
    }
}

impl Street {
    /// A street for a drive of this length from x = 0.
    pub(super) fn new(seed: u32, travel_m: f64) -> Self {
        let end_m = LEAST_END_M.max(travel_m as f32 + AHEAD_M);
        let mut builder = StreetBuilder::default();
        add_pavements(&mut builder, end_m);
        let buildings = add_rows(&mut builder, seed, end_m);
        add_trees(&mut builder, seed, end_m);
        add_furniture(&mut builder, seed, end_m);
        add_hills(&mut builder, seed);
        Self {
            mesh: Mesh::new(builder.mesh.triangles),
            materials: builder.materials,
            buildings,
        }
    }
}

/// How many things stand along the street where `least` stand along the shortest, `every_m` apart.
fn count_along(least: u32, every_m: f32, end_m: f32) -> u32 {
    least + ((end_m - LEAST_END_M) / every_m) as u32
}

fn add_pavements(builder: &mut StreetBuilder, end_m: f32) {
    let (kerb, slab) = (
        builder.material(Material::Kerb),
        builder.material(Material::Pavement),
    );
    for side in [-1.0_f32, 1.0] {
        let strip = |y0: f32, y1: f32| {
            let (a, b) = (side * y0, side * y1);
            (
                Vec3::new(START_M, a.min(b), -0.2),
                Vec3::new(end_m - 6.0, a.max(b), PAVEMENT_Z_M),
            )
        };
        let inner = ROAD_HALF_WIDTH_M + KERB_WIDTH_M;
        let (min, max) = strip(ROAD_HALF_WIDTH_M, inner);
        builder.mesh.cuboid(min, max, kerb);
        let (min, max) = strip(inner, FACADE_Y_M + 1.0);
        builder.mesh.cuboid(min, max, slab);
    }
}

/// Two rows of buildings and one across the far end.
fn add_rows(builder: &mut StreetBuilder, seed: u32, end_m: f32) -> Vec<Building> {
    let mut buildings = Vec::new();
    for (row, side) in [(0_u32, 1.0_f32), (1, -1.0)] {
        let mut x = START_M - 3.0 * row as f32;
        let mut index = 0;
        while x < end_m - 8.0 {
            let draw = |k: u32| unit(seed.wrapping_add(7 + row), index, k);
            let width = 9.0 + 6.5 * draw(0);
            // Now and then a side street leaves a gap.
            let gap = if index > 0 && draw(1) < 0.14 {
                5.5
            } else {
                0.0
            };
            let building = Building::draw(seed.wrapping_add(row * 977 + index * 31));
            let face = FACADE_Y_M + 0.35 * (draw(2) - 0.5);
            let origin = Vec3::new(x + if side > 0.0 { width } else { 0.0 }, side * face, 0.0);
            let along = Vec3::X * -side;
            add_building(
                builder,
                &building,
                buildings.len() as u16,
                origin,
                along,
                width,
            );
            buildings.push(building);
            x += width + gap;
            index += 1;
        }
    }
    for k in 0..4 {
        let building = Building::draw(seed.wrapping_add(5000 + k));
        let origin = Vec3::new(end_m + 6.0, 12.0 * k as f32 - 24.0, 0.0);
        add_building(
            builder,
            &building,
            buildings.len() as u16,
            origin,
            Vec3::Y,
            12.0,
        );
        buildings.push(building);
    }
    buildings
}

fn add_trees(builder: &mut StreetBuilder, seed: u32, end_m: f32) {
    let bark = builder.material(Material::Bark);
    for (row, side) in [(0_u32, 1.0_f32), (1, -1.0)] {
        for i in 0..count_along(11, 17.0, end_m) {
            let draw = |k: u32| unit(seed.wrapping_add(70 + row), i, k);
            if draw(0) < 0.2 {
                continue;
            }
            let x = -22.0 + 17.0 * i as f32 + 8.0 * row as f32 + 4.0 * (draw(1) - 0.5);
            let root = Vec3::new(x, side * (6.75 + 0.2 * draw(2)), PAVEMENT_Z_M);
            let height = 2.5 + 0.7 * draw(3);
            let fork = root + Vec3::Z * height + Vec3::X * (0.2 * (draw(4) - 0.5));
            builder.mesh.tube([root, fork], [0.17, 0.11], 12, bark);
            let leaves = builder.material(Material::Leaves((i % 3) as u16));
            for blob in 0..5_u32 {
                let spread = |k: u32| draw(10 + blob * 4 + k) - 0.5;
                let lift = 0.7 + 1.5 * (spread(2) + 0.5);
                let centre = fork + Vec3::new(1.9 * spread(0), 1.5 * spread(1), lift);
                let radius = Vec3::new(1.15, 1.1, 0.95) * (0.85 + 0.4 * spread(3));
                let salt = seed.wrapping_add(i * 8 + blob + row * 300);
                builder
                    .mesh
                    .bumpy_sphere(centre, radius, 20, |d| crown(d, salt), leaves);
            }
        }
    }
}

/// Radius of a tree's crown in a direction, relative to its mean.
fn crown(direction: Vec3, salt: u32) -> f32 {
    let p = Vec2::new(
        direction.x + 0.6 * direction.z,
        direction.y - 0.5 * direction.z,
    );
    let q = Vec2::new(direction.y + 0.4 * direction.x, direction.z);
    1.0 + 0.13 * value(p * 2.3, salt)
        + 0.10 * value(q * 5.0, salt ^ 77)
        + 0.05 * value(p * 11.0, salt ^ 78)
}

fn add_furniture(builder: &mut StreetBuilder, seed: u32, end_m: f32) {
    let (metal, lamp) = (
        builder.material(Material::Metal),
        builder.material(Material::Lamp),
    );
    let (sign, bin) = (
        builder.material(Material::RoadSign),
        builder.material(Material::Bin),
    );
    for i in 0..count_along(9, 21.0, end_m) {
        let side = if i % 2 == 0 { 1.0 } else { -1.0 };
        let root = Vec3::new(-14.0 + 21.0 * i as f32, side * 6.15, PAVEMENT_Z_M);
        let top = root + Vec3::Z * 5.6;
        builder
            .mesh
            .tube([root, root + Vec3::Z * 1.0], [0.11, 0.10], 12, metal);
        builder
            .mesh
            .tube([root + Vec3::Z * 1.0, top], [0.07, 0.05], 10, metal);
        let tip = top + Vec3::new(0.0, -side * 1.5, 0.25);
        builder.mesh.tube([top, tip], [0.05, 0.04], 8, metal);
        builder.mesh.cuboid(
            tip - Vec3::new(0.13, 0.32, 0.10),
            tip + Vec3::new(0.13, 0.32, 0.03),
            lamp,
        );
    }
    for i in 0..count_along(8, 19.0, end_m) {
        let draw = |k: u32| unit(seed.wrapping_add(300), i, k);
        let side = if i % 2 == 0 { -1.0 } else { 1.0 };
        let root = Vec3::new(
            4.0 + 19.0 * i as f32 + 5.0 * draw(0),
            side * 6.1,
            PAVEMENT_Z_M,
        );
        if i % 3 == 1 {
            builder
                .mesh
                .tube([root, root + Vec3::Z * 0.85], [0.24, 0.27], 16, bin);
            builder
                .mesh
                .disc(root + Vec3::Z * 0.85, Vec3::Z, 0.27, 16, metal);
        } else {
            let top = root + Vec3::Z * 2.75;
            builder.mesh.tube([root, top], [0.035, 0.035], 8, metal);
            builder
                .mesh
                .disc(top - Vec3::new(0.04, 0.0, 0.3), Vec3::NEG_X, 0.32, 24, sign);
            builder
                .mesh
                .disc(top - Vec3::new(-0.04, 0.0, 0.3), Vec3::X, 0.32, 24, metal);
        }
    }
}

/// A ring of wooded hills so that the street ends in a landscape.
fn add_hills(builder: &mut StreetBuilder, seed: u32) {
    let hill = builder.material(Material::Hill);
    const SIDES: u32 = 180;
    let crest = |i: u32| {
        let angle = std::f32::consts::TAU * (i % SIDES) as f32 / SIDES as f32;
        let (radius, around) = (420.0, Vec2::from_angle(angle));
        let p = around * 4.0;
        let height = 26.0
            + 16.0 * value(p, seed.wrapping_add(61))
            + 5.0 * value(p * 4.0, seed.wrapping_add(62));
        let foot = Vec3::new(60.0 + around.x * 300.0, around.y * 300.0, -1.0);
        let top = Vec3::new(60.0 + around.x * radius, around.y * radius, height);
        (foot, top)
    };
    for i in 0..SIDES {
        let ((a, d), (b, c)) = (crest(i), crest(i + 1));
        builder.mesh.quad([a, b, c, d], hill);
    }
}
