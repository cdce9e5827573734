//! Total variation of a level's values on the bricks that a step touched.
//!
//! DVGO's kernel: a node's gradient is a sixth of the sum over its six neighbours of `clamp(v - v_n, -1, 1)`. It is applied
//! by itself, times the learning rate, instead of through the optimiser, whose normalisation would undo its weight.

use rayon::prelude::*;

use crate::field::lattice::{BRICK_NODES, BRICK_SIDE, FEATURES, Lattice, NULL_BRICK};
use crate::volume::variation_loss;

/// Bricks smoothed from the same state, to bound the gradients' memory to 28 MB; later blocks see earlier ones smoothed.
const BLOCK: usize = 1024;
/// Values of a node: density, then features.
const VALUES: usize = 1 + FEATURES;

/// Buffers of the smoothing, reused from step to step.
#[derive(Clone, Debug, Default)]
pub(super) struct Smoother {
    bricks: Vec<u32>,
    gradients: Vec<[f32; VALUES]>,
}

impl Smoother {
    /// Moves density and features of the `touched` bricks (in any order, repeated at will) against their variation.
    pub(super) fn smooth(
        &mut self,
        level: &mut Lattice,
        touched: impl Iterator<Item = u32>,
        density_rate: f32,
        feature_rate: f32,
    ) {
        self.bricks.clear();
        self.bricks.extend(touched);
        self.bricks.sort_unstable();
        self.bricks.dedup();
        for block in self.bricks.chunks(BLOCK) {
            self.gradients
                .resize(block.len() * BRICK_NODES, [0.0; VALUES]);
            let frozen = &*level;
            self.gradients
                .par_chunks_exact_mut(BRICK_NODES)
                .zip(block)
                .for_each(|(out, brick)| {
                    brick_gradient(frozen, *brick, feature_rate > 0.0, out);
                });
            let (density, features) = level.parameters_mut();
            for (brick, gradients) in block.iter().zip(self.gradients.chunks_exact(BRICK_NODES)) {
                let first = *brick as usize * BRICK_NODES;
                for (node, gradient) in (first..).zip(gradients) {
                    density[node] -= density_rate * gradient[0];
                    let pairs = features[node].iter_mut().zip(&gradient[1..]);
                    pairs.for_each(|(value, g)| *value -= feature_rate * g);
                }
            }
        }
    }
}

/// Gradients of the level's variation by one brick's values.
fn brick_gradient(level: &Lattice, brick: u32, with_features: bool, out: &mut [[f32; VALUES]]) {
    let neighbours = neighbour_bricks(level, brick);
    let strides = [1, BRICK_SIDE, BRICK_SIDE * BRICK_SIDE];
    for (local, gradient) in out.iter_mut().enumerate() {
        *gradient = [0.0; VALUES];
        let node = brick as usize * BRICK_NODES + local;
        for (side, neighbour) in neighbours.iter().enumerate() {
            let stride = strides[side / 2];
            let at = local / stride % BRICK_SIDE;
            let upper = side % 2 == 1;
            let other = match (upper, at) {
                (false, 0) => other_brick(*neighbour, local + stride * (BRICK_SIDE - 1)),
                (true, 7) => other_brick(*neighbour, local - stride * (BRICK_SIDE - 1)),
                (false, _) => Some(node - stride),
                (true, _) => Some(node + stride),
            };
            // Where nothing is stored there is no neighbour.
            let Some(other) = other else { continue };
            let sixth = |a: f32, b: f32| variation_loss(a - b).gradient / 6.0;
            gradient[0] += sixth(level.density()[node], level.density()[other]);
            if with_features {
                let pairs = level.features()[node].iter().zip(&level.features()[other]);
                for (g, (a, b)) in gradient[1..].iter_mut().zip(pairs) {
                    *g += sixth(*a, *b);
                }
            }
        }
    }
}

fn other_brick(brick: u32, local: usize) -> Option<usize> {
    (brick != NULL_BRICK).then_some(brick as usize * BRICK_NODES + local)
}

/// The stored bricks across the faces -x, +x, -y, +y, -z, +z.
fn neighbour_bricks(level: &Lattice, brick: u32) -> [u32; 6] {
    let position = level.positions()[brick as usize];
    std::array::from_fn(|side| {
        let mut at = position;
        let axis = &mut at[side / 2];
        match side % 2 {
            0 if *axis == 0 => return NULL_BRICK,
            0 => *axis -= 1,
            _ => *axis += 1,
        }
        level.brick(at)
    })
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;
    use crate::scene::Draws;

    /// Two bricks side by side and one apart, with differences on both sides of the clamp.
    fn level() -> Lattice {
        let mut draws = Draws::new(4, 0, 0);
        let mut level = Lattice::new(0.5, Vec3::ZERO, Vec3::splat(12.0)).unwrap();
        for position in [[0, 0, 0], [1, 0, 0], [2, 2, 2]] {
            level.allocate(position).unwrap();
        }
        let (density, features) = level.parameters_mut();
        density[BRICK_NODES..].fill_with(|| draws.jitter(1.0) as f32);
        features[BRICK_NODES..].fill_with(|| std::array::from_fn(|_| draws.jitter(0.3) as f32));
        level
    }

    /// Variation of the density in f64: every pair of stored neighbours once, a sixth each.
    fn variation(level: &Lattice, density: &[f64]) -> f64 {
        let at = |x: i32, y: i32, z: i32| {
            let brick = level.brick([x, y, z].map(|c| (c.max(0) / 8) as u16));
            let local = ((z & 7) * 8 + (y & 7)) * 8 + (x & 7);
            (brick != NULL_BRICK && x.min(y).min(z) >= 0)
                .then(|| density[brick as usize * BRICK_NODES + local as usize])
        };
        let mut sum = 0.0;
        for x in 0..24 {
            for y in 0..24 {
                for z in 0..24 {
                    let Some(a) = at(x, y, z) else { continue };
                    let next = [at(x + 1, y, z), at(x, y + 1, z), at(x, y, z + 1)];
                    for b in next.into_iter().flatten() {
                        let d: f64 = (a - b).abs();
                        sum += if d < 1.0 { d * d / 2.0 } else { d - 0.5 };
                    }
                }
            }
        }
        sum / 6.0
    }

    #[test]
    fn the_gradient_is_that_of_the_pairs_variation_and_one_without_neighbour_bricks_is_not() {
        let level = level();
        let density: Vec<f64> = level.density().iter().map(|d| f64::from(*d)).collect();
        let mut out = vec![[0.0; VALUES]; BRICK_NODES];
        brick_gradient(&level, 1, false, &mut out);
        // Broken: the same brick with nothing beside it.
        let mut alone = level.clone();
        alone.retain(|brick| brick == 1);
        let mut broken = vec![[0.0; VALUES]; BRICK_NODES];
        brick_gradient(&alone, 1, false, &mut broken);
        let (mut worst, mut worst_broken) = (0.0f64, 0.0f64);
        for local in (0..BRICK_NODES).step_by(7) {
            let change = |h: f64| {
                let mut moved = density.clone();
                moved[BRICK_NODES + local] += h;
                variation(&level, &moved)
            };
            let numeric = (change(1e-5) - change(-1e-5)) / 2e-5;
            worst = worst.max((f64::from(out[local][0]) - numeric).abs());
            worst_broken = worst_broken.max((f64::from(broken[local][0]) - numeric).abs());
        }
        // Gradients are up to 1.
        assert!(worst < 1e-4, "{worst}");
        assert!(worst_broken > 1e-2, "{worst_broken}");
    }

    #[test]
    fn smoothing_lowers_the_variation_of_touched_bricks_only() {
        let mut level = level();
        let before = level.clone();
        let variation = |level: &Lattice| {
            let density: Vec<f64> = level.density().iter().map(|d| f64::from(*d)).collect();
            variation(level, &density)
        };
        let mut smoother = Smoother::default();
        smoother.smooth(&mut level, [1, 2, 1].into_iter(), 0.3, 0.3);
        assert!(variation(&level) < 0.8 * variation(&before));
        let apart = 3 * BRICK_NODES..;
        assert_eq!(
            level.density()[apart.clone()],
            before.density()[apart.clone()]
        );
        assert_eq!(level.features()[apart.clone()], before.features()[apart]);
        assert_ne!(
            level.features()[BRICK_NODES],
            before.features()[BRICK_NODES]
        );
        assert!(level.density()[..BRICK_NODES].iter().all(|d| *d == 0.0));
    }
}
