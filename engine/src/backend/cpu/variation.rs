//! Total variation of a level's values on the bricks that a step touched.
//!
//! DVGO's kernel: a node's gradient is a sixth of the sum over its six neighbours of `clamp(v - v_n, -1, 1)`. It is applied
//! by itself, times the learning rate, instead of through the optimiser, whose normalisation would undo its weight.

use rayon::prelude::*;

use crate::field::lattice::{BRICK_NODES, BRICK_SIDE, FEATURES, Lattice, NULL_BRICK};
use crate::volume::variation_loss;

/// Bricks smoothed from the same state, to bound the gradients' memory to 27 MB; later blocks see earlier ones smoothed.
const BLOCK: usize = 1024;

/// Buffers of the smoothing, reused from step to step.
#[derive(Clone, Debug, Default)]
pub(super) struct Smoother {
    bricks: Vec<u32>,
    density: Vec<f32>,
    features: Vec<[f32; FEATURES]>,
}

impl Smoother {
    /// Moves density and features of the `touched` bricks (in any order, repeated at will) against their variation. A rate of 0
    /// leaves its values alone and costs nothing.
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
            if density_rate > 0.0 {
                let gradients = &mut self.density;
                fill(level, block, gradients, |node, other| {
                    variation(level.density()[node], level.density()[other])
                });
                let values = level.parameters_mut().0;
                move_against(values, block, gradients, |v, g| *v -= density_rate * g);
            }
            if feature_rate > 0.0 {
                let gradients = &mut self.features;
                fill(level, block, gradients, |node, other| {
                    let (a, b) = (&level.features()[node], &level.features()[other]);
                    std::array::from_fn(|f| variation(a[f], b[f]))
                });
                let values = level.parameters_mut().1;
                move_against(values, block, gradients, |v, g| {
                    (0..FEATURES).for_each(|f| v[f] -= feature_rate * g[f]);
                });
            }
        }
    }
}

fn variation(a: f32, b: f32) -> f32 {
    variation_loss(a - b).gradient / 6.0
}

/// What can be summed over neighbours.
trait Sum: Copy + Default + Send + Sync {
    fn add(&mut self, other: Self);
}

impl Sum for f32 {
    fn add(&mut self, other: Self) {
        *self += other;
    }
}

impl Sum for [f32; FEATURES] {
    fn add(&mut self, other: Self) {
        (0..FEATURES).for_each(|f| self[f] += other[f]);
    }
}

/// Fills `out` with the gradients of every node of `bricks`: the sum of `pair(node, neighbour)` over the neighbours.
fn fill<T: Sum>(
    level: &Lattice,
    bricks: &[u32],
    out: &mut Vec<T>,
    pair: impl Fn(usize, usize) -> T + Sync,
) {
    out.resize(bricks.len() * BRICK_NODES, T::default());
    out.par_chunks_exact_mut(BRICK_NODES)
        .zip(bricks)
        .for_each(|(out, brick)| brick_gradient(level, *brick, out, &pair));
}

fn move_against<T, V>(
    values: &mut [V],
    bricks: &[u32],
    gradients: &[T],
    apply: impl Fn(&mut V, &T),
) {
    for (brick, gradients) in bricks.iter().zip(gradients.chunks_exact(BRICK_NODES)) {
        let first = *brick as usize * BRICK_NODES;
        let values = &mut values[first..first + BRICK_NODES];
        values
            .iter_mut()
            .zip(gradients)
            .for_each(|(v, g)| apply(v, g));
    }
}

/// Sums of `pair` over the stored neighbours of one brick's nodes.
fn brick_gradient<T: Sum>(
    level: &Lattice,
    brick: u32,
    out: &mut [T],
    pair: &impl Fn(usize, usize) -> T,
) {
    let neighbours = neighbour_bricks(level, brick);
    let strides = [1, BRICK_SIDE, BRICK_SIDE * BRICK_SIDE];
    for (local, gradient) in out.iter_mut().enumerate() {
        *gradient = T::default();
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
            if let Some(other) = other {
                gradient.add(pair(node, other));
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
        let gradient = |level: &Lattice| {
            let mut out = vec![0.0f32; BRICK_NODES];
            let density = level.density();
            let pair = |a: usize, b: usize| super::variation(density[a], density[b]);
            brick_gradient(level, 1, &mut out, &pair);
            out
        };
        let out = gradient(&level);
        // Broken: the same brick with nothing beside it.
        let mut alone = level.clone();
        alone.retain(|brick| brick == 1);
        let broken = gradient(&alone);
        let (mut worst, mut worst_broken) = (0.0f64, 0.0f64);
        for local in (0..BRICK_NODES).step_by(7) {
            let change = |h: f64| {
                let mut moved = density.clone();
                moved[BRICK_NODES + local] += h;
                variation(&level, &moved)
            };
            let numeric = (change(1e-5) - change(-1e-5)) / 2e-5;
            worst = worst.max((f64::from(out[local]) - numeric).abs());
            worst_broken = worst_broken.max((f64::from(broken[local]) - numeric).abs());
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
