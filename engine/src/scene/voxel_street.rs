//! What the voxelised street hides, summed straight from its analytic nodes in f64: the oracle of the valid region's sight lines.

use glam::{DVec3, IVec3};

use super::box_world::{BoxWorld, RAW_PER_VOXEL};
use super::density::HALF_TAU;

/// Steps of the sums: a fiftieth of a voxel where there is density.
const STEP_M: f64 = 0.005;
const EMPTY_STEP_M: f64 = 0.05;

/// Nodes `voxel_m` apart from `low` on, x fastest; raw density as [`BoxWorld::voxelised`] defines it.
pub(super) struct VoxelStreet {
    low: DVec3,
    voxel_m: f64,
    nodes: IVec3,
    raw: Vec<f64>,
}

impl VoxelStreet {
    pub(super) fn new(world: &BoxWorld, voxel_m: f64) -> Self {
        let (low, high) = world.voxel_bounds();
        let nodes = ((high - low) / voxel_m).ceil().as_ivec3() + 2;
        let mut raw = Vec::with_capacity(nodes.element_product() as usize);
        for z in 0..nodes.z {
            for y in 0..nodes.y {
                for x in 0..nodes.x {
                    let p = low + IVec3::new(x, y, z).as_dvec3() * voxel_m;
                    let voxels = (world.depth(p) / voxel_m).clamp(-1.0, 1.0);
                    raw.push(f64::from(RAW_PER_VOXEL) * voxels);
                }
            }
        }
        Self {
            low,
            voxel_m,
            nodes,
            raw,
        }
    }

    /// Density in 1/m and whether any node around is under a surface or near to one.
    fn sigma(&self, p: DVec3) -> (f64, bool) {
        let at = (p - self.low) / self.voxel_m;
        let cell = at.floor();
        let part = at - cell;
        let cell = cell.as_ivec3();
        if cell.min_element() < 0 || (cell + 1).cmpge(self.nodes).any() {
            return (0.0, false);
        }
        let (mut raw, mut highest) = (0.0, f64::MIN);
        for corner in 0..8 {
            let bit = IVec3::new(corner & 1, corner >> 1 & 1, corner >> 2 & 1);
            let n = cell + bit;
            let node = self.raw[((n.z * self.nodes.y + n.y) * self.nodes.x + n.x) as usize];
            let far = bit.as_dvec3();
            let weight = far * part + (1.0 - far) * (1.0 - part);
            raw += weight.element_product() * node;
            highest = highest.max(node);
        }
        let sigma = libm::log1p(libm::exp(raw)) / self.voxel_m;
        (sigma, highest > -f64::from(RAW_PER_VOXEL))
    }

    /// Distance at which half of the light is gone, if before `reach_m`.
    fn stop(&self, eye: DVec3, direction: DVec3, reach_m: f64) -> Option<f64> {
        let (mut t, mut tau) = (0.0, 0.0);
        while t < reach_m {
            let (sigma, near_surface) = self.sigma(eye + direction * (t + 0.5 * STEP_M));
            let step = if near_surface { STEP_M } else { EMPTY_STEP_M };
            tau += sigma * step;
            if tau >= HALF_TAU {
                return Some(t + step);
            }
            t += step;
        }
        None
    }

    /// Whether an eye sees a place on the ground, to 0.2 m of its height, and the space 0.8 m above it, to 0.3 m.
    pub(super) fn sees(&self, eye: DVec3, ground: DVec3) -> bool {
        let offset = ground - eye;
        let range = offset.length();
        let stop = self.stop(eye, offset / range, range + 10.0);
        let on_ground = stop.is_some_and(|t| {
            let height = eye.z + offset.z / range * t;
            (height - ground.z).abs() <= 0.2
        });
        let body = offset + DVec3::Z * 0.8;
        let range = body.length();
        on_ground && self.stop(eye, body / range, range - 0.3).is_none()
    }
}
