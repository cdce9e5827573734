//! Buildings: walls with recessed windows, doors, shop fronts, ledges and roofs.

use glam::Vec3;

use super::noise::unit;
use super::street::{Material, StreetBuilder};

/// Style of one building.
#[derive(Clone, Debug)]
pub(super) struct Building {
    pub(super) seed: u32,
    /// Bricks if true, plaster otherwise.
    pub(super) brick: bool,
    /// Linear RGB.
    pub(super) wall: Vec3,
    pub(super) trim: Vec3,
    pub(super) accent: Vec3,
    floors: u32,
    shop: bool,
    pitched: bool,
}

const BRICKS: [[f32; 3]; 4] = [
    [0.30, 0.115, 0.075],
    [0.36, 0.19, 0.12],
    [0.42, 0.30, 0.19],
    [0.24, 0.10, 0.075],
];
const PLASTERS: [[f32; 3]; 6] = [
    [0.58, 0.50, 0.37],
    [0.62, 0.60, 0.55],
    [0.55, 0.38, 0.24],
    [0.40, 0.46, 0.47],
    [0.60, 0.45, 0.38],
    [0.47, 0.50, 0.38],
];
const ACCENTS: [[f32; 3]; 6] = [
    [0.05, 0.14, 0.26],
    [0.33, 0.05, 0.05],
    [0.05, 0.20, 0.11],
    [0.35, 0.20, 0.05],
    [0.10, 0.10, 0.11],
    [0.24, 0.07, 0.18],
];

const GROUND_FLOOR_M: f32 = 3.5;
const FLOOR_M: f32 = 3.05;
const DEPTH_M: f32 = 10.0;

impl Building {
    pub(super) fn draw(seed: u32) -> Self {
        let pick = |k: u32, n: usize| (unit(seed, k, 11) * n as f32) as usize;
        let brick = unit(seed, 0, 11) < 0.45;
        let wall = if brick {
            BRICKS[pick(1, 4)]
        } else {
            PLASTERS[pick(2, 6)]
        };
        Self {
            seed,
            brick,
            wall: Vec3::from(wall),
            trim: if brick {
                Vec3::new(0.58, 0.55, 0.48)
            } else {
                Vec3::new(0.66, 0.64, 0.60)
            },
            accent: Vec3::from(ACCENTS[pick(3, 6)]),
            floors: 2 + pick(4, 3) as u32,
            shop: unit(seed, 5, 11) < 0.5,
            pitched: unit(seed, 6, 11) < 0.55,
        }
    }

    fn height_m(&self) -> f32 {
        GROUND_FLOOR_M + FLOOR_M * self.floors as f32 + 0.5
    }
}

/// The plane of a facade: u along the wall, z up, d outwards.
struct Face {
    origin: Vec3,
    along: Vec3,
    outward: Vec3,
}

/// A hole in a wall and what closes it.
struct Opening {
    u: [f32; 2],
    z: [f32; 2],
    recess_m: f32,
    pane: Material,
    bars: bool,
}

impl Face {
    fn at(&self, u: f32, z: f32, d: f32) -> Vec3 {
        self.origin + self.along * u + Vec3::Z * z + self.outward * d
    }

    fn rect(&self, builder: &mut StreetBuilder, u: [f32; 2], z: [f32; 2], d: f32, material: u16) {
        if u[1] - u[0] > 1e-4 && z[1] - z[0] > 1e-4 {
            let corners = [
                self.at(u[0], z[0], d),
                self.at(u[1], z[0], d),
                self.at(u[1], z[1], d),
                self.at(u[0], z[1], d),
            ];
            builder.mesh.quad(corners, material);
        }
    }

    /// A ledge or frame between depths d[0] and d[1].
    fn slab(
        &self,
        builder: &mut StreetBuilder,
        u: [f32; 2],
        z: [f32; 2],
        d: [f32; 2],
        material: u16,
    ) {
        let (a, b) = (self.at(u[0], z[0], d[0]), self.at(u[1], z[1], d[1]));
        builder.mesh.cuboid(a.min(b), a.max(b), material);
    }
}

/// Adds a building whose street front starts at `origin` and runs `width` along `along`, seen from outside from right to left.
pub(super) fn add_building(
    builder: &mut StreetBuilder,
    building: &Building,
    index: u16,
    origin: Vec3,
    along: Vec3,
    width: f32,
) {
    let face = Face {
        origin,
        along,
        outward: Vec3::Z.cross(along),
    };
    let wall = builder.material(Material::Wall(index));
    let columns = (width / 2.7).floor().max(2.0) as u32;
    let step = width / columns as f32;
    let door = (unit(building.seed, 7, 11) * columns as f32) as u32;
    for column in 0..columns {
        let u = [column as f32 * step, (column + 1) as f32 * step];
        let ground = ground_opening(building, index, u, column == door);
        add_bay(builder, &face, index, u, [0.0, GROUND_FLOOR_M], &ground);
        for floor in 0..building.floors {
            let z0 = GROUND_FLOOR_M + FLOOR_M * floor as f32;
            let middle = 0.5 * (u[0] + u[1]);
            let window = Opening {
                u: [middle - 0.58, middle + 0.58],
                z: [z0 + 0.75, z0 + 2.35],
                recess_m: 0.16,
                pane: Material::Pane(index),
                bars: true,
            };
            add_bay(builder, &face, index, u, [z0, z0 + FLOOR_M], &window);
        }
    }
    let height = building.height_m();
    face.rect(builder, [0.0, width], [height - 0.5, height], 0.0, wall);
    add_ledges(builder, building, &face, index, width);
    add_shell(builder, building, &face, index, width);
}

fn ground_opening(building: &Building, index: u16, u: [f32; 2], door: bool) -> Opening {
    let middle = 0.5 * (u[0] + u[1]);
    if door {
        let (u, z) = ([middle - 0.55, middle + 0.55], [0.13, 2.45]);
        return Opening {
            u,
            z,
            recess_m: 0.28,
            pane: Material::Door(index),
            bars: false,
        };
    }
    if building.shop {
        let (u, z) = ([u[0] + 0.22, u[1] - 0.22], [0.65, 2.65]);
        return Opening {
            u,
            z,
            recess_m: 0.22,
            pane: Material::ShopPane(index),
            bars: false,
        };
    }
    let (u, z) = ([middle - 0.6, middle + 0.6], [1.05, 2.65]);
    Opening {
        u,
        z,
        recess_m: 0.16,
        pane: Material::Pane(index),
        bars: true,
    }
}

/// One bay of a floor: wall around an opening, its reveals, pane, bars and sill.
fn add_bay(
    builder: &mut StreetBuilder,
    face: &Face,
    index: u16,
    u: [f32; 2],
    z: [f32; 2],
    hole: &Opening,
) {
    let (wall, trim) = (
        builder.material(Material::Wall(index)),
        builder.material(Material::Trim(index)),
    );
    let pane = builder.material(hole.pane);
    face.rect(builder, [u[0], hole.u[0]], z, 0.0, wall);
    face.rect(builder, [hole.u[1], u[1]], z, 0.0, wall);
    face.rect(builder, hole.u, [z[0], hole.z[0]], 0.0, wall);
    face.rect(builder, hole.u, [hole.z[1], z[1]], 0.0, wall);
    let back = -hole.recess_m;
    face.rect(builder, hole.u, hole.z, back, pane);
    for edge in hole.u {
        let corners = [
            (edge, hole.z[0], 0.0),
            (edge, hole.z[1], 0.0),
            (edge, hole.z[1], back),
            (edge, hole.z[0], back),
        ];
        builder
            .mesh
            .quad(corners.map(|(u, z, d)| face.at(u, z, d)), trim);
    }
    for edge in hole.z {
        let corners = [
            (hole.u[0], edge, 0.0),
            (hole.u[1], edge, 0.0),
            (hole.u[1], edge, back),
            (hole.u[0], edge, back),
        ];
        builder
            .mesh
            .quad(corners.map(|(u, z, d)| face.at(u, z, d)), trim);
    }
    if !hole.bars {
        return;
    }
    const BAR_M: f32 = 0.07;
    let front = back + 0.04;
    let middle = 0.5 * (hole.u[0] + hole.u[1]);
    let transom = hole.z[1] - 0.42;
    for u in [hole.u[0] + 0.5 * BAR_M, middle, hole.u[1] - 0.5 * BAR_M] {
        face.slab(
            builder,
            [u - 0.5 * BAR_M, u + 0.5 * BAR_M],
            hole.z,
            [back, front],
            trim,
        );
    }
    for z in [hole.z[0] + 0.5 * BAR_M, transom, hole.z[1] - 0.5 * BAR_M] {
        face.slab(
            builder,
            hole.u,
            [z - 0.5 * BAR_M, z + 0.5 * BAR_M],
            [back, front],
            trim,
        );
    }
    face.slab(
        builder,
        [hole.u[0] - 0.1, hole.u[1] + 0.1],
        [hole.z[0] - 0.1, hole.z[0]],
        [back, 0.1],
        trim,
    );
    if unit(index.into(), 9, 11) < 0.6 {
        face.slab(
            builder,
            [hole.u[0] - 0.12, hole.u[1] + 0.12],
            [hole.z[1], hole.z[1] + 0.18],
            [0.0, 0.05],
            trim,
        );
    }
}

fn add_ledges(
    builder: &mut StreetBuilder,
    building: &Building,
    face: &Face,
    index: u16,
    width: f32,
) {
    let trim = builder.material(Material::Trim(index));
    let height = building.height_m();
    face.slab(
        builder,
        [0.0, width],
        [height - 0.28, height],
        [-0.3, 0.26],
        trim,
    );
    face.slab(
        builder,
        [0.0, width],
        [height - 0.45, height - 0.28],
        [0.0, 0.12],
        trim,
    );
    face.slab(
        builder,
        [0.0, width],
        [GROUND_FLOOR_M - 0.08, GROUND_FLOOR_M + 0.12],
        [0.0, 0.09],
        trim,
    );
    face.slab(builder, [0.0, width], [0.0, 0.42], [0.0, 0.05], trim);
    if building.shop {
        let sign = builder.material(Material::Sign(index));
        face.slab(
            builder,
            [0.25, width - 0.25],
            [2.78, 3.32],
            [0.0, 0.14],
            sign,
        );
    }
}

/// Side walls, back and roof.
fn add_shell(
    builder: &mut StreetBuilder,
    building: &Building,
    face: &Face,
    index: u16,
    width: f32,
) {
    let (wall, roof) = (
        builder.material(Material::Wall(index)),
        builder.material(Material::Roof(index)),
    );
    let height = building.height_m();
    let ridge = if building.pitched {
        height + 3.2
    } else {
        height
    };
    for u in [0.0, width] {
        let side = [
            (0.0, 0.0),
            (0.0, height),
            (-DEPTH_M, height),
            (-DEPTH_M, 0.0),
        ];
        builder.mesh.quad(side.map(|(d, z)| face.at(u, z, d)), wall);
        let gable = [(0.0, height), (-0.5 * DEPTH_M, ridge), (-DEPTH_M, height)]
            .map(|(d, z)| face.at(u, z, d));
        builder.mesh.triangle(gable[0], gable[1], gable[2], wall);
    }
    face.rect(builder, [0.0, width], [0.0, height], -DEPTH_M, wall);
    for (outer, sign) in [(0.0, 1.0), (-DEPTH_M, -1.0)] {
        let eave = outer + 0.2 * sign;
        let slope = [
            (0.0, eave, height),
            (width, eave, height),
            (width, -0.5 * DEPTH_M, ridge),
            (0.0, -0.5 * DEPTH_M, ridge),
        ];
        builder
            .mesh
            .quad(slope.map(|(u, d, z)| face.at(u, z, d)), roof);
    }
}
