//! Gradients to parameters: points sorted by brick, then every brick summed and updated by one owner.
//!
//! A brick's gradients are summed in registers and first-level cache by whichever thread owns the brick and are applied at
//! once, so there is no gradient array, no atomic operation, and the sums do not depend on the number of threads.

use glam::{IVec3, Vec3};
use rayon::prelude::*;

use super::chunk::{Chunk, NO_SLOT};
use super::lanes::Lanes;
use super::mlp::PADDED_FEATURES;
use super::simd::{Simd, dispatch};
use crate::field::lattice::{BRICK_NODES, BRICK_SIDE, FEATURES, Lattice};
use crate::train::ray::Rates;

/// Decay of the squared gradients' running mean.
pub(in crate::backend) const DECAY: f32 = 0.95;
/// Added to the root of the mean square, or a gradient of nothing would move a parameter by the full rate.
pub(in crate::backend) const EPSILON: f32 = 1e-10;

/// Optimiser state of one level: RMSProp with one second moment per node for density and one for its 12 features.
#[derive(Clone, Debug, Default)]
pub(super) struct LevelOptimizer {
    density_square: Vec<f32>,
    features_square: Vec<f32>,
    bins: Bins,
}

/// (chunk, point) pairs sorted by brick.
#[derive(Clone, Debug, Default)]
struct Bins {
    /// `ends[b]` is the end of brick b's pairs in `points`; `ends[b - 1]` their start.
    ends: Vec<u32>,
    /// Chunk in the upper half, point in the lower.
    points: Vec<u32>,
}

impl LevelOptimizer {
    pub(super) fn resize(&mut self, bricks: usize) {
        self.density_square.resize(bricks * BRICK_NODES, 0.0);
        self.features_square.resize(bricks * BRICK_NODES, 0.0);
    }

    /// Follows [`Lattice::retain`].
    pub(super) fn retain(&mut self, old_of_new: &[u32]) {
        for (new, old) in old_of_new.iter().enumerate() {
            let from = *old as usize * BRICK_NODES;
            let from = from..from + BRICK_NODES;
            self.density_square
                .copy_within(from.clone(), new * BRICK_NODES);
            self.features_square.copy_within(from, new * BRICK_NODES);
        }
        self.density_square.truncate(old_of_new.len() * BRICK_NODES);
        self.features_square
            .truncate(old_of_new.len() * BRICK_NODES);
    }

    /// Sums the chunks' gradients on level number `number` and moves its parameters against them.
    pub(super) fn step(
        &mut self,
        level: &mut Lattice,
        number: usize,
        chunks: &[Chunk],
        rates: Rates,
        simd: Simd,
    ) {
        self.resize(level.brick_count());
        self.bins.sort(level.brick_count(), number, chunks);
        let bins = &self.bins;
        let parameters = level.placed_parameters_mut();
        let (voxel_m, origin_m) = (parameters.voxel_m, parameters.origin_m);
        let positions = parameters.positions;
        parameters
            .density
            .par_chunks_exact_mut(BRICK_NODES)
            .zip(parameters.features.par_chunks_exact_mut(BRICK_NODES))
            .zip(self.density_square.par_chunks_exact_mut(BRICK_NODES))
            .zip(self.features_square.par_chunks_exact_mut(BRICK_NODES))
            .enumerate()
            .with_min_len(BRICKS_PER_TASK)
            .for_each_init(
                Sums::default,
                |sums, (brick, (((density, features), density_square), features_square))| {
                    let points = bins.of(brick);
                    if !points.is_empty() {
                        let mut owned = OwnedBrick {
                            origin_m,
                            nodes_per_m: 1.0 / voxel_m,
                            first_node: IVec3::from(positions[brick].map(|c| i32::from(c) * 8)),
                            density,
                            features,
                            density_square,
                            features_square,
                        };
                        step_brick(simd, &mut owned, points, chunks, rates, sums);
                    }
                },
            );
    }
}

impl Bins {
    /// Counting sort; pairs of a brick keep the chunks' order, so sums are the same on every run.
    fn sort(&mut self, bricks: usize, level: usize, chunks: &[Chunk]) {
        self.ends.clear();
        self.ends.resize(bricks + 1, 0);
        for (brick, _) in chunks.iter().flat_map(|chunk| &chunk.touched[level]) {
            self.ends[*brick as usize + 1] += 1;
        }
        let mut total = 0;
        for end in &mut self.ends {
            total += *end;
            *end = total;
        }
        self.points.clear();
        self.points.resize(total as usize, 0);
        // ends[b] now is the start of brick b and moves to its end while its pairs are placed.
        for (number, chunk) in chunks.iter().enumerate() {
            for (brick, point) in &chunk.touched[level] {
                let at = &mut self.ends[*brick as usize];
                self.points[*at as usize] = (number as u32) << 16 | point;
                *at += 1;
            }
        }
    }

    fn of(&self, brick: usize) -> &[u32] {
        let start = if brick == 0 { 0 } else { self.ends[brick - 1] };
        &self.points[start as usize..self.ends[brick] as usize]
    }
}

/// Bricks that a thread takes at a time: enough that fresh sums, 34 kB, cost little.
const BRICKS_PER_TASK: usize = 128;

/// Gradient sums of one brick, all 0 between bricks: clearing the few nodes that were touched is cheaper than all.
#[derive(Debug)]
struct Sums {
    density: Box<[f32; BRICK_NODES]>,
    /// Padded, so that a row is whole registers.
    features: Box<[[f32; PADDED_FEATURES]; BRICK_NODES]>,
}

impl Default for Sums {
    fn default() -> Self {
        Self {
            density: Box::new([0.0; BRICK_NODES]),
            features: Box::new([[0.0; PADDED_FEATURES]; BRICK_NODES]),
        }
    }
}

struct OwnedBrick<'a> {
    origin_m: Vec3,
    nodes_per_m: f32,
    /// Lattice coordinates of the brick's first node.
    first_node: IVec3,
    density: &'a mut [f32],
    features: &'a mut [[f32; FEATURES]],
    density_square: &'a mut [f32],
    features_square: &'a mut [f32],
}

impl OwnedBrick<'_> {
    /// Calls `add(node, weight)` for the corners around `p` that are the brick's own; mirrors [`Lattice::corners`].
    #[inline(always)]
    fn for_each_corner(&self, p: Vec3, mut add: impl FnMut(usize, f32)) {
        let q = (p - self.origin_m) * self.nodes_per_m;
        let base = q.as_ivec3();
        let high = q - base.as_vec3();
        let low = Vec3::ONE - high;
        let local = base - self.first_node;
        for corner in 0..8i32 {
            let step = IVec3::new(corner & 1, corner >> 1 & 1, corner >> 2);
            let node = local + step;
            if (node.x | node.y | node.z) as u32 >= BRICK_SIDE as u32 {
                continue;
            }
            let weight = Vec3::select(step.cmpne(IVec3::ZERO), high, low);
            let number = (node.z * 8 + node.y) * 8 + node.x;
            add(number as usize, weight.x * weight.y * weight.z);
        }
    }
}

dispatch!(fn step_brick => step_brick_generic(
    owned: &mut OwnedBrick<'_>,
    points: &[u32],
    chunks: &[Chunk],
    rates: Rates,
    sums: &mut Sums,
));

#[inline(always)]
fn step_brick_generic<L: Lanes, const R: usize, const V: usize>(
    owned: &mut OwnedBrick<'_>,
    points: &[u32],
    chunks: &[Chunk],
    rates: Rates,
    sums: &mut Sums,
) {
    let Sums { density, features } = sums;
    let mut touched = [0u64; BRICK_NODES / 64];
    let mut colored = [0u64; BRICK_NODES / 64];
    for pair in points {
        let chunk = &chunks[(pair >> 16) as usize];
        let point = &chunk.points[(pair & 0xffff) as usize];
        let gradient = (point.slot != NO_SLOT).then(|| {
            let row = &chunk.batch.feature_gradients[point.slot as usize * PADDED_FEATURES..];
            &row[..PADDED_FEATURES]
        });
        owned.for_each_corner(point.position, |node, weight| {
            touched[node / 64] |= 1 << (node % 64);
            density[node] += weight * point.raw;
            if let Some(gradient) = gradient {
                colored[node / 64] |= 1 << (node % 64);
                add_scaled::<L>(weight, gradient, &mut features[node]);
            }
        });
    }
    for node in set_bits(&touched) {
        let gradient = std::mem::take(&mut density[node]);
        let root = mean_square_root(&mut owned.density_square[node], gradient * gradient);
        owned.density[node] -= rates.density * gradient / root;
    }
    for node in set_bits(&colored) {
        let gradient = std::mem::take(&mut features[node]);
        // The padding's gradients are 0.
        let square = gradient.iter().map(|g| g * g).sum::<f32>() / FEATURES as f32;
        let rate = rates.features / mean_square_root(&mut owned.features_square[node], square);
        (0..FEATURES).for_each(|f| owned.features[node][f] -= rate * gradient[f]);
    }
}

#[inline(always)]
fn add_scaled<L: Lanes>(scale: f32, row: &[f32], sum: &mut [f32; PADDED_FEATURES]) {
    let scale = L::splat(scale);
    for at in (0..PADDED_FEATURES).step_by(L::WIDTH) {
        let sum = &mut sum[at..];
        scale
            .multiply_add(L::load(&row[at..]), L::load(sum))
            .store(sum);
    }
}

/// Updates the running mean, which starts at its first value, and returns its root.
#[inline(always)]
fn mean_square_root(mean: &mut f32, square: f32) -> f32 {
    *mean = if *mean == 0.0 {
        square
    } else {
        DECAY * *mean + (1.0 - DECAY) * square
    };
    mean.sqrt() + EPSILON
}

#[inline(always)]
fn set_bits(words: &[u64; BRICK_NODES / 64]) -> impl Iterator<Item = usize> {
    words.iter().enumerate().flat_map(|(number, word)| {
        let mut word = *word;
        std::iter::from_fn(move || {
            let bit = word.trailing_zeros() as usize;
            (word != 0).then(|| {
                word &= word - 1;
                number * 64 + bit
            })
        })
    })
}
