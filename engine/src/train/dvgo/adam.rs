//! Gradients summed brick by brick and applied by Adam.
//!
//! One owner sums a brick's gradients in first-level cache and applies them at once: there is no gradient array and no atomic
//! operation, and the sums do not depend on the number of threads.

use glam::{IVec3, Vec3};
use rayon::prelude::*;

use super::bins::Bins;
use super::chunk::Chunk;
use super::grid::{Shape, trilinear};
use crate::backend::cpu::adam::{BETA1, BETA2, EPSILON};
use crate::backend::cpu::lanes::Lanes;
use crate::backend::cpu::prefetch::prefetch;
use crate::backend::cpu::simd::dispatch;
use crate::backend::cpu::{NO_SLOT, Simd};
use crate::field::{BRICK_NODES, BRICK_SIDE};

/// Distances of a cell's corners from its first within a brick.
const CORNERS: [usize; 8] = [0, 1, 8, 9, 64, 65, 72, 73];
const LAST_CORNER: usize = 73;
/// Pairs between the one that is asked for and the one that is summed.
const AHEAD: usize = 8;
/// Where every value moves at every step, one without gradient for this many steps rests: its update, at most
/// (0.9 / sqrt 0.99)^200 = 5e-9 of the rate, is below the rounding of the values. Its moments go on decaying.
pub(crate) const LIVELY_STEPS: u32 = 200;

/// Moments of a grid's densities and colour values.
#[derive(Clone, Debug)]
pub(super) struct GridAdam<const C: usize> {
    density: Moments<f32>,
    colors: Moments<[f32; C]>,
    /// Step of a brick's last gradient and of its last update.
    seen: Vec<(u32, u32)>,
    /// Factor on the density's rate at every node; empty is 1.
    density_shares: Vec<f32>,
    masked: bool,
    steps: u32,
    bins: Bins,
}

/// Running means of gradients and of their squares, one each per value.
#[derive(Clone, Debug)]
struct Moments<T> {
    mean: Vec<T>,
    square: Vec<T>,
}

/// Values with their moments.
struct Moved<'a, T> {
    values: &'a mut [T],
    mean: &'a mut [T],
    square: &'a mut [T],
}

/// Learning rates of a step, bias correction included.
#[derive(Clone, Copy, Debug)]
struct StepRates {
    density: f32,
    color: f32,
}

/// A brick's values with all that moves them.
struct OwnedBrick<'a, const C: usize> {
    /// Node coordinates of its first node.
    first: IVec3,
    /// Last base of a cell.
    last_base: IVec3,
    density: Moved<'a, f32>,
    colors: Moved<'a, [f32; C]>,
    seen: &'a mut (u32, u32),
    density_shares: &'a [f32],
}

/// What all bricks of a step share.
#[derive(Clone, Copy)]
struct BrickStep<'a, const C: usize> {
    chunks: &'a [Chunk<C>],
    rates: StepRates,
    masked: bool,
    step: u32,
}

impl<const C: usize> GridAdam<C> {
    /// Fresh moments. With `masked`, a value without gradient in a step keeps its moments and stays.
    pub(super) fn new(shape: &Shape, masked: bool, density_shares: Vec<f32>) -> Self {
        let count = shape.len();
        Self {
            density: Moments {
                mean: vec![0.0; count],
                square: vec![0.0; count],
            },
            colors: Moments {
                mean: vec![[0.0; C]; count],
                square: vec![[0.0; C]; count],
            },
            seen: vec![(0, 0); shape.brick_count()],
            density_shares,
            masked,
            steps: 0,
            bins: Bins::default(),
        }
    }

    /// Moves the values of a grid against the chunks' gradients.
    pub(super) fn step(
        &mut self,
        shape: &Shape,
        (density, colors): (&mut [f32], &mut [[f32; C]]),
        chunks: &[Chunk<C>],
        (density_rate, color_rate): (f64, f64),
        simd: Simd,
    ) {
        self.steps += 1;
        let correction = bias_correction(self.steps);
        let all = BrickStep {
            chunks,
            rates: StepRates {
                density: (density_rate * correction) as f32,
                color: (color_rate * correction) as f32,
            },
            masked: self.masked,
            step: self.steps,
        };
        self.bins.sort(shape.brick_count(), chunks);
        let (bins, shares) = (&self.bins, &self.density_shares);
        bricks_of(density, &mut self.density)
            .zip(bricks_of(colors, &mut self.colors))
            .zip(self.seen.par_iter_mut())
            .enumerate()
            .with_min_len(8)
            .for_each(|(brick, ((density, colors), seen))| {
                let nodes = brick * BRICK_NODES..(brick + 1) * BRICK_NODES;
                let mut owned = OwnedBrick {
                    first: (shape.brick_position(brick) * BRICK_SIDE as u32).as_ivec3(),
                    last_base: (shape.nodes - 2).as_ivec3(),
                    density,
                    colors,
                    seen,
                    density_shares: shares.get(nodes).unwrap_or_default(),
                };
                owned.step(simd, &all, bins.of(brick));
            });
    }
}

fn bricks_of<'a, T: Send>(
    values: &'a mut [T],
    moments: &'a mut Moments<T>,
) -> impl IndexedParallelIterator<Item = Moved<'a, T>> {
    values
        .par_chunks_exact_mut(BRICK_NODES)
        .zip(moments.mean.par_chunks_exact_mut(BRICK_NODES))
        .zip(moments.square.par_chunks_exact_mut(BRICK_NODES))
        .map(|((values, mean), square)| Moved {
            values,
            mean,
            square,
        })
}

/// sqrt(1 - b2^t) / (1 - b1^t).
pub(crate) fn bias_correction(step: u32) -> f64 {
    let step = step as i32;
    (1.0 - f64::from(BETA2).powi(step)).sqrt() / (1.0 - f64::from(BETA1).powi(step))
}

impl<const C: usize> OwnedBrick<'_, C> {
    fn step(&mut self, simd: Simd, all: &BrickStep<'_, C>, pairs: &[(u32, u32)]) {
        if all.masked {
            if !pairs.is_empty() {
                step_brick(simd, self, all, pairs);
            }
            return;
        }
        let (seen, updated) = *self.seen;
        if !pairs.is_empty() {
            self.seen.0 = all.step;
        } else if seen == 0 || all.step - seen > LIVELY_STEPS {
            return;
        }
        // Steps at which the brick rested.
        let rested = all.step - 1 - updated;
        if seen > 0 && rested > 0 {
            self.decay(rested);
        }
        self.seen.1 = all.step;
        step_brick(simd, self, all, pairs);
    }

    fn decay(&mut self, steps: u32) {
        let (b1, b2) = (BETA1.powi(steps as i32), BETA2.powi(steps as i32));
        let (density, colors) = (&mut self.density, &mut self.colors);
        let means = density
            .mean
            .iter_mut()
            .chain(colors.mean.as_flattened_mut());
        means.for_each(|m| *m *= b1);
        let squares = density
            .square
            .iter_mut()
            .chain(colors.square.as_flattened_mut());
        squares.for_each(|v| *v *= b2);
    }
}

dispatch!(fn step_brick<const C> => step_brick_generic(
    owned: &mut OwnedBrick<'_, C>,
    all: &BrickStep<'_, C>,
    pairs: &[(u32, u32)],
));

#[inline(always)]
fn step_brick_generic<L: Lanes, const R: usize, const V: usize, const C: usize>(
    owned: &mut OwnedBrick<'_, C>,
    all: &BrickStep<'_, C>,
    pairs: &[(u32, u32)],
) {
    let mut density = [0.0f32; BRICK_NODES];
    let mut colors = [[0.0f32; C]; BRICK_NODES];
    let mut touched = [0u64; BRICK_NODES / 64];
    owned.sum(all.chunks, pairs, &mut density, &mut colors, &mut touched);
    let rates = all.rates;
    let shares = owned.density_shares;
    owned
        .density
        .step(&density, rates.density, shares, all.masked);
    if !all.masked {
        let mut flat = Moved {
            values: owned.colors.values.as_flattened_mut(),
            mean: owned.colors.mean.as_flattened_mut(),
            square: owned.colors.square.as_flattened_mut(),
        };
        flat.step(colors.as_flattened(), rates.color, &[], false);
        return;
    }
    for (number, word) in touched.into_iter().enumerate() {
        let mut word = word;
        while word != 0 {
            let node = number * 64 + word.trailing_zeros() as usize;
            word &= word - 1;
            let mut row = Moved {
                values: &mut owned.colors.values[node],
                mean: &mut owned.colors.mean[node],
                square: &mut owned.colors.square[node],
            };
            row.step(&colors[node], rates.color, &[], true);
        }
    }
}

impl<const C: usize> OwnedBrick<'_, C> {
    /// Adds the points' gradients to those of the brick's own nodes among their corners.
    #[inline(always)]
    fn sum(
        &self,
        chunks: &[Chunk<C>],
        pairs: &[(u32, u32)],
        density: &mut [f32; BRICK_NODES],
        colors: &mut [[f32; C]; BRICK_NODES],
        touched: &mut [u64; BRICK_NODES / 64],
    ) {
        for (number, (chunk, point)) in pairs.iter().enumerate() {
            // First the point, then, once it is there, its row.
            if let Some((chunk, point)) = pairs.get(number + 2 * AHEAD) {
                prefetch(&chunks[*chunk as usize].points, *point as usize);
            }
            if let Some((chunk, point)) = pairs.get(number + AHEAD) {
                let chunk = &chunks[*chunk as usize];
                let slot = chunk.points[*point as usize].slot as usize;
                prefetch(&chunk.color_gradients, slot);
            }
            let chunk = &chunks[*chunk as usize];
            let point = &chunk.points[*point as usize];
            let color =
                (point.slot != NO_SLOT).then(|| &chunk.color_gradients[point.slot as usize]);
            let (local, weights) = self.locate(point.q);
            if local.min_element() >= 0 && local.max_element() < BRICK_SIDE as i32 - 1 {
                // Two of three cells lie within the brick, and their corners at fixed distances.
                let first = ((local.z * 8 + local.y) * 8 + local.x) as usize;
                let sums = &mut density[first..first + LAST_CORNER + 1];
                for (offset, weight) in CORNERS.into_iter().zip(weights) {
                    sums[offset] += weight * point.raw;
                }
                if let Some(color) = color {
                    let sums = &mut colors[first..first + LAST_CORNER + 1];
                    for (offset, weight) in CORNERS.into_iter().zip(weights) {
                        let at = first + offset;
                        touched[at / 64] |= 1 << (at % 64);
                        (0..C).for_each(|c| sums[offset][c] += weight * color[c]);
                    }
                }
                continue;
            }
            for (corner, weight) in weights.into_iter().enumerate() {
                let corner = corner as i32;
                let node = local + IVec3::new(corner & 1, corner >> 1 & 1, corner >> 2);
                if (node.x | node.y | node.z) as u32 >= BRICK_SIDE as u32 {
                    continue;
                }
                let at = ((node.z * 8 + node.y) * 8 + node.x) as usize & (BRICK_NODES - 1);
                density[at] += weight * point.raw;
                if let Some(color) = color {
                    touched[at / 64] |= 1 << (at % 64);
                    (0..C).for_each(|c| colors[at][c] += weight * color[c]);
                }
            }
        }
    }

    /// The first corner of a point's cell relative to the brick, and the corners' weights.
    #[inline(always)]
    fn locate(&self, q: Vec3) -> (IVec3, [f32; 8]) {
        let base = q.as_ivec3().min(self.last_base);
        (base - self.first, trilinear(q - base.as_vec3()))
    }
}

impl Moved<'_, f32> {
    /// `x -= rate share m / (sqrt v + eps)`; with `masked`, only where the gradient is not 0. No shares are all 1.
    #[inline(always)]
    fn step(&mut self, gradients: &[f32], rate: f32, shares: &[f32], masked: bool) {
        let count = gradients.len();
        let (values, mean, square) = (
            &mut self.values[..count],
            &mut self.mean[..count],
            &mut self.square[..count],
        );
        for i in 0..count {
            let g = gradients[i];
            let share = if shares.is_empty() { 1.0 } else { shares[i] };
            let m = BETA1 * mean[i] + (1.0 - BETA1) * g;
            let v = BETA2 * square[i] + (1.0 - BETA2) * g * g;
            let moved = values[i] - rate * share * m / (v.sqrt() + EPSILON);
            let moves = !masked || g != 0.0;
            mean[i] = if moves { m } else { mean[i] };
            square[i] = if moves { v } else { square[i] };
            values[i] = if moves { moved } else { values[i] };
        }
    }
}
