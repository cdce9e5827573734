//! The scene on which backends are timed: a fuzzy ball in 128^3 voxels, seen by random rays that look up 128 densities on average and colour
//! 15 to 16 samples. Nothing is skipped, and no ray ends before it leaves the box.

use glam::{UVec3, Vec3};

use crate::field::{BRICK_NODES, ColorMlp, DensityActivation, Field, Lattice, Occupancy, Ray};
use crate::scene::Draws;
use crate::train::ray::{Backdrop, RayLosses, Silhouette, TrainRay};

const SIDE_M: f32 = 12.8;
const VOXEL_M: f32 = 0.1;
/// Steps along an edge of the box; most rays cross it obliquely.
const STEPS: f32 = 112.0;
/// Of the ball, in which density rises towards the centre.
const RADIUS_M: f32 = 2.9;

/// Dense nodes, features at random, a network of this width, no sky.
pub fn field(width: usize) -> Field {
    let mut draws = Draws::new(21, 0, 0);
    let (low, size) = (Vec3::splat(-SIDE_M / 2.0), Vec3::splat(SIDE_M));
    let mut level = Lattice::new(VOXEL_M, low, size).expect("a small box");
    level.allocate_all();
    let bricks = level.brick_count();
    let origins: Vec<Vec3> = level
        .positions()
        .iter()
        .map(|p| level.brick_origin(*p))
        .collect();
    let (density, features) = level.parameters_mut();
    for (brick, origin) in origins.iter().enumerate().take(bricks).skip(1) {
        for node in 0..BRICK_NODES {
            let at = UVec3::new(node as u32 & 7, node as u32 >> 3 & 7, node as u32 >> 6);
            let p = *origin + at.as_vec3() * VOXEL_M;
            let depth = 1.0 - p.length() / RADIUS_M;
            // Raw density of nothing outside, some tenths per metre inside.
            density[brick * BRICK_NODES + node] = if depth > 0.0 {
                4.0 + 2.0 * depth
            } else {
                -20.0
            };
            features[brick * BRICK_NODES + node] =
                std::array::from_fn(|_| draws.jitter(1.0) as f32);
        }
    }
    let mut occupancy = Occupancy::new(2.0 * VOXEL_M, low, size).expect("a small box");
    occupancy.fill(SIDE_M / STEPS);
    Field {
        bounds_m: (low, low + size),
        levels: vec![level],
        activation: DensityActivation::from_alpha(1e-3, VOXEL_M),
        mlp: ColorMlp::new(width, || draws.unit()),
        sky: None,
        occupancy,
        step_growth: 0.0,
    }
}

/// Rays from all around through the box, each with a colour.
pub fn rays(count: usize) -> Vec<TrainRay> {
    let mut draws = Draws::new(22, 0, 0);
    let mut point = |reach: f64| Vec3::from([(); 3].map(|()| draws.jitter(reach) as f32));
    (0..count)
        .map(|_| {
            let origin = point(1.0).normalize_or(Vec3::X) * 12.0;
            let target = point(4.0);
            TrainRay {
                ray: Ray {
                    origin,
                    direction: (target - origin).normalize_or(Vec3::X),
                },
                phase: 0.5,
                t_max: f32::INFINITY,
                color: [0.5; 3],
                color_weight: 1.0 / count as f32,
                backdrop: Backdrop::Color([1.0; 3]),
                silhouette: Silhouette::Unknown,
                silhouette_weight: 0.0,
                range_m: 0.0,
                range_weight: 0.0,
                view: 0,
                mirrored: false,
            }
        })
        .collect()
}

/// Colour alone; samples of hardly any weight are not coloured.
pub const LOSSES: RayLosses = RayLosses {
    sample_color: 0.0,
    entropy: 0.0,
    depth_scale_m: 0.1,
    depth_cap_m: 1.0,
    min_weight: 1e-4,
    depth_trim_m: f32::INFINITY,
    depth: crate::train::ray::DepthForm::Expected,
    rectified: crate::train::ray::Rectified::CrossEntropy,
    distortion: 0.0,
    distortion_scale_m: 10.0,
    density_variation: 0.0,
    feature_variation: 0.0,
    exposure_prior: 0.0,
    pose_prior: 0.0,
};
