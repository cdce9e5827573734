//! A field with every feature that marching meets, and rays through it.

use std::sync::Arc;

use glam::{UVec3, Vec3};

use crate::backend::cpu::CpuBackend;
use crate::backend::{Backend, LoadedField, MarchRay, Marched};
use crate::field::{
    BRICK_NODES, ColorMlp, DensityActivation, Field, Lattice, MarchRange, Occupancy, Ray,
};

const LOW_M: Vec3 = Vec3::new(-3.0, -4.0, -1.0);
const SIZE_M: Vec3 = Vec3::new(12.8, 9.6, 6.4);
const CELL_M: f32 = 0.4;
pub(in crate::backend) const SAMPLES_PER_RAY: u32 = 256;

/// Three levels (one dense, two sparse) of smooth density, with occupied and empty cells and blocks.
pub(in crate::backend) fn field() -> Field {
    let mut levels = Vec::new();
    for (voxel_m, kept) in [(0.8, 1), (0.4, 2), (0.2, 3)] {
        let mut level = Lattice::new(voxel_m, LOW_M, SIZE_M).expect("the box is small");
        let bricks = level.bricks_per_axis();
        for at in positions(bricks) {
            if (at.x + 2 * at.y + 3 * at.z) % kept == 0 {
                level.allocate(at.to_array().map(|c| c as u16));
            }
        }
        fill(&mut level);
        levels.push(level);
    }
    Field {
        bounds_m: (LOW_M, LOW_M + SIZE_M),
        levels,
        activation: DensityActivation::from_alpha(1e-2, 0.2),
        mlp: ColorMlp::new(16, || 0.5),
        sky: None,
        occupancy: occupancy(),
        step_growth: 0.01,
    }
}

fn fill(level: &mut Lattice) {
    for brick in 1..level.brick_count() {
        let origin = level.brick_origin(level.positions()[brick]);
        let voxel_m = level.voxel_m();
        for node in 0..BRICK_NODES {
            let offset = UVec3::new(node as u32 & 7, node as u32 >> 3 & 7, node as u32 >> 6);
            let p = origin + offset.as_vec3() * voxel_m;
            let wave = (1.3 * p.x).sin() + (0.9 * p.y + 0.5).cos() + (1.7 * p.z - 0.2).sin();
            level.parameters_mut().0[brick * BRICK_NODES + node] = 1.2 * wave - 0.4;
        }
    }
}

fn occupancy() -> Occupancy {
    let mut occupancy = Occupancy::new(CELL_M, LOW_M, SIZE_M).expect("the box is small");
    for at in positions(occupancy.blocks_per_axis()) {
        match (at.x + at.y + at.z) % 3 {
            0 => {}
            1 => occupancy.set_block(at, [u64::MAX; 8], 0.1),
            _ => occupancy.set_block(
                at,
                [
                    0x00ff_00f0_ff0f_f0f0,
                    u64::MAX,
                    0,
                    0xf0f0_0f0f_ffff_0000,
                    0,
                    u64::MAX,
                    7,
                    0,
                ],
                0.05,
            ),
        }
    }
    occupancy
}

fn positions(counts: UVec3) -> impl Iterator<Item = UVec3> {
    (0..counts.z).flat_map(move |z| {
        (0..counts.y).flat_map(move |y| (0..counts.x).map(move |x| UVec3::new(x, y, z)))
    })
}

/// Rays through the box, past it, from inside it, with different ranges; some stop early.
pub(in crate::backend) fn rays() -> Vec<MarchRay> {
    let eye = Vec3::new(-5.0, 1.1, 2.3);
    let mut rays = Vec::new();
    for i in 0..1500_u32 {
        // Golden-ratio sequences: even cover, no direction parallel to an axis.
        let (u, v) = (fraction(i, 0.618_034), fraction(i, 0.754_878));
        let target = Vec3::new(5.0, 16.0 * u - 8.0, 10.0 * v - 3.5);
        let inside = Vec3::new(0.3, 0.2, 1.9);
        let origin = if i % 5 == 0 { inside } else { eye };
        let stop_tau = if i % 3 == 0 { 0.7 } else { 9.0 };
        rays.push(MarchRay {
            ray: Ray {
                origin,
                direction: (target - origin).normalize_or_zero(),
            },
            range: MarchRange {
                t_min: 0.11 * (i % 4) as f32,
                t_max: 14.03,
                stop_tau,
                phase: 0.2 + 0.3 * v,
            },
        });
    }
    rays
}

fn fraction(i: u32, step: f64) -> f32 {
    (0.5 + f64::from(i) * step).fract() as f32
}

#[cfg(feature = "gpu")]
/// The rays on which every decision of the CPU stays the same when the ray is moved by far more than f32 rounding.
pub(in crate::backend) fn away_from_faces(field: &Arc<Field>, rays: &[MarchRay]) -> Vec<MarchRay> {
    /// Some hundred roundings of a coordinate of 16 m.
    const MOVED_M: f32 = 2e-4;
    let reference = march_cpu(field, rays);
    let mut stable = vec![true; rays.len()];
    let moves = [Vec3::X, Vec3::Y, Vec3::Z]
        .into_iter()
        .flat_map(|axis| [axis * MOVED_M, axis * -MOVED_M]);
    for (moved_m, scale) in moves.zip([1.0, 1.0 - 1e-3, 1.0 + 1e-3].into_iter().cycle()) {
        let moved: Vec<MarchRay> = rays.iter().map(|ray| moved(ray, moved_m, scale)).collect();
        let marched = march_cpu(field, &moved);
        for (ray, stable) in stable.iter_mut().enumerate() {
            *stable &=
                marched.summaries()[ray].sample_count == reference.summaries()[ray].sample_count;
        }
    }
    rays.iter()
        .zip(stable)
        .filter_map(|(ray, stable)| stable.then_some(*ray))
        .collect()
}

#[cfg(feature = "gpu")]
fn moved(ray: &MarchRay, by_m: Vec3, stop_scale: f32) -> MarchRay {
    let mut moved = *ray;
    moved.ray.origin += by_m;
    moved.range.t_max += by_m.element_sum();
    moved.range.stop_tau *= stop_scale;
    moved
}

pub(in crate::backend) fn march_cpu(field: &Arc<Field>, rays: &[MarchRay]) -> Marched {
    let loaded = CpuBackend.load(field).expect("the CPU loads any field");
    march(loaded.as_ref(), rays)
}

pub(in crate::backend) fn march(loaded: &dyn LoadedField, rays: &[MarchRay]) -> Marched {
    loaded
        .march(rays, SAMPLES_PER_RAY, &|| false)
        .expect("the rays are within the limits")
}
