//! A street with everything that merged rendering meets: ground, wall, haze, sky, cars near and far, one translucent, one parked.

use std::sync::Arc;

use glam::{DMat3, DQuat, DVec2, DVec3, UVec3, Vec3};

use crate::camera::{Camera, Distortion, Rigid};
use crate::field::{
    BRICK_NODES, BRICK_SIDE, ColorMlp, DensityActivation, Field, Lattice, Occupancy, SkyGrid,
    SkyMap,
};
use crate::scene::{Draws, Scene, SceneObject, StaticObject, Tone};

pub(super) const CAR_M: DVec3 = DVec3::new(4.0, 2.0, 1.6);
const PARKED_AT: DVec3 = DVec3::new(16.0, -4.0, 0.8);

/// Haze lies up to here; above is open sky.
const HAZE_TOP_M: f32 = 1.9;

pub(super) struct Street {
    pub(super) background: Arc<Field>,
    pub(super) solid: Arc<Field>,
    pub(super) glass: Arc<Field>,
}

impl Street {
    pub(super) fn new() -> Self {
        Self {
            background: Arc::new(background(&[0.8, 0.4])),
            solid: Arc::new(car(60.0, 21)),
            glass: Arc::new(car(0.6, 22)),
        }
    }

    /// The same with a background of eight times the nodes.
    pub(super) fn fine() -> Self {
        Self {
            background: Arc::new(background(&[0.8, 0.2])),
            ..Self::new()
        }
    }

    /// A frame with two solid cars, a translucent one that one of them touches, a small far one, and the parked one.
    pub(super) fn scene(&self, camera: Camera) -> Scene<'_> {
        let object = |instance_id, field, x, y, heading| SceneObject {
            instance_id,
            field,
            local_from_object: Rigid::from_heading(heading, DVec3::new(x, y, 0.8)),
            size_m: CAR_M,
            tone: Tone::IDENTITY,
        };
        let dimmed = Tone {
            gain: [0.8, 0.9, 1.1],
            offset: [0.05, 0.0, -0.02],
        };
        Scene {
            background: Some(&self.background),
            objects: vec![
                object(1, &self.solid, 9.0, 1.4, 0.3),
                object(2, &self.glass, 11.5, -0.4, -0.8),
                SceneObject {
                    tone: dimmed,
                    ..object(3, &self.solid, 13.5, 0.9, 1.9)
                },
                object(4, &self.solid, 42.0, -17.5, 0.1),
            ],
            statics: vec![StaticObject {
                instance_id: 5,
                local_from_object: Rigid::from_heading(0.0, PARKED_AT),
                size_m: CAR_M,
            }],
            camera,
            local_from_camera: Rigid::new(forward_from_camera(), DVec3::new(0.5, 0.0, 1.5)),
        }
    }
}

/// From the camera's frame (z forward) to one with x forward, y left, z up.
fn forward_from_camera() -> DQuat {
    DQuat::from_mat3(&DMat3::from_cols(-DVec3::Y, -DVec3::Z, DVec3::X))
}

/// The KITTI camera's size and focal length.
pub(super) fn camera(distortion: Distortion) -> Camera {
    Camera {
        width: 1242,
        height: 375,
        focal_px: DVec2::new(721.5, 719.2),
        principal_px: DVec2::new(609.6, 172.9),
        distortion,
    }
}

fn background(voxels_m: &[f32]) -> Field {
    let (low, high) = (Vec3::new(0.0, -12.0, -1.0), Vec3::new(64.0, 12.0, 5.4));
    let sigma = |p: Vec3| {
        let parked = (p - PARKED_AT.as_vec3()).abs();
        let in_car = parked.cmple(CAR_M.as_vec3() * 0.5).all();
        let in_wall = (25.0..26.0).contains(&p.x) && p.y > 2.0;
        if p.z <= -0.1 || in_car || in_wall {
            40.0
        } else if p.z < HAZE_TOP_M {
            0.012
        } else {
            0.0
        }
    };
    let mut field = field(low, high, voxels_m, 7, 64, sigma);
    let mut draws = Draws::new(5, 0, 0);
    let grids = [(8, 4), (64, 32)].map(|(width, height)| {
        let mut grid = SkyGrid::new(width, height);
        for logit in grid.logits_mut().as_flattened_mut() {
            *logit = draws.uniform(-1.0, 1.0) as f32;
        }
        grid
    });
    field.sky = Some(SkyMap::new(grids.to_vec()));
    field
}

fn car(solid: f32, seed: u64) -> Field {
    let half = (CAR_M * 0.5).as_vec3();
    let sigma = |p: Vec3| {
        if p.abs().cmple(half).all() {
            solid
        } else {
            1e-6
        }
    };
    field(-half - 0.25, half + 0.25, &[0.2, 0.1], seed, 16, sigma)
}

/// Density on the finest of the levels, smooth features on all of them, and a network drawn from the seed.
fn field(
    low: Vec3,
    high: Vec3,
    voxels_m: &[f32],
    seed: u64,
    width: usize,
    sigma: impl Fn(Vec3) -> f32,
) -> Field {
    let finest_m = voxels_m.last().copied().expect("a level");
    let activation = DensityActivation::from_alpha(1e-6, finest_m);
    let mut levels = Vec::new();
    for voxel_m in voxels_m {
        let mut level = Lattice::new(*voxel_m, low, high - low).expect("a small box");
        level.allocate_all();
        let bricks = level.positions()[1..].to_vec();
        let origins: Vec<Vec3> = bricks.iter().map(|at| level.brick_origin(*at)).collect();
        let is_finest = *voxel_m == finest_m;
        let (density, features) = level.parameters_mut();
        for node in BRICK_NODES..density.len() {
            let within = node % BRICK_NODES;
            let step = |shift: u32| (within >> shift & (BRICK_SIDE - 1)) as f32;
            let p =
                origins[node / BRICK_NODES - 1] + Vec3::new(step(0), step(3), step(6)) * *voxel_m;
            if is_finest {
                density[node] = activation.raw(sigma(p).max(1e-6));
            }
            for (f, feature) in features[node].iter_mut().enumerate() {
                let pitch = 0.35 + 0.11 * f as f32;
                *feature = 0.6 * libm::sinf(pitch * (p.x + 1.7 * p.y + 2.3 * p.z) + f as f32);
            }
        }
        levels.push(level);
    }
    let mut draws = Draws::new(seed, 0, 0);
    Field {
        bounds_m: (low, high),
        occupancy: occupied(low, high, finest_m, sigma),
        levels,
        activation,
        mlp: ColorMlp::new(width, || draws.unit()),
        sky: None,
        step_growth: 0.004,
    }
}

/// Blocks within a voxel of anything denser than clear air.
fn occupied(low: Vec3, high: Vec3, voxel_m: f32, sigma: impl Fn(Vec3) -> f32) -> Occupancy {
    let mut occupancy = Occupancy::new(voxel_m, low, high - low).expect("a small box");
    let blocks = occupancy.blocks_per_axis();
    let side_m = voxel_m * 8.0;
    for number in 0..blocks.element_product() {
        let at = UVec3::new(
            number % blocks.x,
            number / blocks.x % blocks.y,
            number / (blocks.x * blocks.y),
        );
        let corner = low + at.as_vec3() * side_m;
        let dense = (0..1000).any(|i| {
            let step = Vec3::new((i % 10) as f32, (i / 10 % 10) as f32, (i / 100) as f32);
            sigma(corner + (step / 9.0 * 1.25 - 0.125) * side_m) > 1e-3
        });
        if dense {
            occupancy.set_block(at, [u64::MAX; 8], voxel_m * 0.7);
        }
    }
    occupancy
}
