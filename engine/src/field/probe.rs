//! Interpolation at several positions at once.
//!
//! Which nodes and weights belong to a position is plain arithmetic without branches and is done for all positions in vector
//! registers; only the look-ups go one by one. The arithmetic is the same on every path, so the results are bit-equal.
#![expect(
    clippy::needless_range_loop,
    reason = "a lane number indexes many arrays at once"
)]

use glam::Vec3;

use super::Field;
use super::lattice::{BRICK_NODES, FEATURES, Lattice, NULL_BRICK};
use crate::backend::cpu::lanes::Lanes;
use crate::backend::cpu::mlp::PADDED_FEATURES;
use crate::backend::cpu::simd::dispatch;

/// Positions handled together: one AVX-512 register, two of AVX2.
pub(crate) const GROUP: usize = 16;

/// A value for each position of a group.
pub(crate) type Lane<T> = [T; GROUP];

/// Positions by coordinate, in metres.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Positions {
    pub(crate) x: Lane<f32>,
    pub(crate) y: Lane<f32>,
    pub(crate) z: Lane<f32>,
}

/// Where a group's positions lie in a level.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Places {
    /// Index cell of the brick with the lower corner; outside the level one that is always null.
    cell: Lane<u32>,
    /// Steps of the index cell to the upper corners: 0 within a brick.
    cell_step: [Lane<u32>; 3],
    /// Number of the lower corner within its brick.
    node: Lane<u32>,
    /// Steps of that number to the upper corners; backwards, wrapping, where they begin the next brick.
    node_step: [Lane<u32>; 3],
    fraction: [Lane<f32>; 3],
}

impl Positions {
    pub(crate) const ZERO: Self = Self {
        x: [0.0; GROUP],
        y: [0.0; GROUP],
        z: [0.0; GROUP],
    };

    #[inline(always)]
    pub(crate) fn set(&mut self, i: usize, p: Vec3) {
        (self.x[i], self.y[i], self.z[i]) = (p.x, p.y, p.z);
    }

    /// Points of a ray at the distances `t`.
    #[inline(always)]
    pub(crate) fn on_ray(origin: [f32; 3], direction: [f32; 3], t: &Lane<f32>) -> Self {
        let mut out = Self::ZERO;
        for i in 0..GROUP {
            out.x[i] = origin[0] + direction[0] * t[i];
            out.y[i] = origin[1] + direction[1] * t[i];
            out.z[i] = origin[2] + direction[2] * t[i];
        }
        out
    }
}

impl Places {
    /// Finds a group's positions in a level.
    #[inline(always)]
    pub(crate) fn of(level: &Lattice, at: &Positions) -> Self {
        let origin = level.origin_m();
        let nodes_per_m = level.nodes_per_m();
        let limit = level.nodes_per_axis();
        let [stride_y, stride_z] = level.index_strides();
        let nowhere = level.index().len() as u32 - 1;
        let mut out = Self {
            cell: [0; GROUP],
            cell_step: [[0; GROUP]; 3],
            node: [0; GROUP],
            node_step: [[0; GROUP]; 3],
            fraction: [[0.0; GROUP]; 3],
        };
        for i in 0..GROUP {
            let x = (at.x[i] - origin.x) * nodes_per_m;
            let y = (at.y[i] - origin.y) * nodes_per_m;
            let z = (at.z[i] - origin.z) * nodes_per_m;
            // Written so that NaN is outside.
            let inside = (x >= 0.0)
                & (y >= 0.0)
                & (z >= 0.0)
                & (x < limit.x)
                & (y < limit.y)
                & (z < limit.z);
            let (bx, by, bz) = (x as i32 as u32, y as i32 as u32, z as i32 as u32);
            out.fraction[0][i] = x - bx as i32 as f32;
            out.fraction[1][i] = y - by as i32 as f32;
            out.fraction[2][i] = z - bz as i32 as f32;
            let (lx, ly, lz) = (bx & 7, by & 7, bz & 7);
            out.node[i] = (lz << 6) | (ly << 3) | lx;
            let cell = (bx >> 3)
                .wrapping_add((by >> 3).wrapping_mul(stride_y))
                .wrapping_add((bz >> 3).wrapping_mul(stride_z));
            out.cell[i] = if inside { cell } else { nowhere };
            let (px, py, pz) = (inside & (lx == 7), inside & (ly == 7), inside & (lz == 7));
            out.cell_step[0][i] = u32::from(px);
            out.cell_step[1][i] = if py { stride_y } else { 0 };
            out.cell_step[2][i] = if pz { stride_z } else { 0 };
            out.node_step[0][i] = if lx == 7 { 7u32.wrapping_neg() } else { 1 };
            out.node_step[1][i] = if ly == 7 { 56u32.wrapping_neg() } else { 8 };
            out.node_step[2][i] = if lz == 7 { 448u32.wrapping_neg() } else { 64 };
        }
        out
    }

    /// The nodes around position `i`, corner `c` having bit 0 for x, 1 for y, 2 for z; `None` where nothing is stored.
    #[inline(always)]
    pub(crate) fn nodes(&self, i: usize, index: &[u32]) -> Option<[u32; 8]> {
        let [sx, sy, sz] = [0, 1, 2].map(|axis| self.cell_step[axis][i]);
        let [nx, ny, nz] = [0, 1, 2].map(|axis| self.node_step[axis][i]);
        let (cell, node) = (self.cell[i], self.node[i]);
        let first = index[cell as usize];
        if sx | sy | sz == 0 {
            if first == NULL_BRICK {
                return None;
            }
            let n = first * BRICK_NODES as u32 + node;
            return Some([n, n + 1, n + 8, n + 9, n + 64, n + 65, n + 72, n + 73]);
        }
        let mut nodes = [0; 8];
        let mut any = NULL_BRICK;
        for (corner, out) in nodes.iter_mut().enumerate() {
            let (x, y, z) = (corner & 1, corner >> 1 & 1, corner >> 2);
            let pick = |bit: usize, step: u32| if bit == 1 { step } else { 0 };
            let brick = index[(cell + pick(x, sx) + pick(y, sy) + pick(z, sz)) as usize];
            any |= brick;
            let within = node
                .wrapping_add(pick(x, nx))
                .wrapping_add(pick(y, ny))
                .wrapping_add(pick(z, nz));
            *out = brick * BRICK_NODES as u32 + within;
        }
        (any != NULL_BRICK).then_some(nodes)
    }

    /// The bricks that [`Self::nodes`] reads, each once, and their number.
    #[inline(always)]
    pub(crate) fn bricks(&self, i: usize, index: &[u32]) -> ([u32; 8], usize) {
        let [sx, sy, sz] = [0, 1, 2].map(|axis| self.cell_step[axis][i]);
        let cell = self.cell[i];
        let mut out = [NULL_BRICK; 8];
        let mut count = 0;
        for z in [0, sz] {
            for y in [0, sy] {
                for x in [0, sx] {
                    let brick = index[(cell + x + y + z) as usize];
                    out[count] = brick;
                    count += usize::from(brick != NULL_BRICK);
                    if sx == 0 {
                        break;
                    }
                }
                if sy == 0 {
                    break;
                }
            }
            if sz == 0 {
                break;
            }
        }
        (out, count)
    }

    /// Trilinear weights of all positions, by corner.
    #[inline(always)]
    pub(crate) fn weights(&self) -> [Lane<f32>; 8] {
        let mut out = [[0.0; GROUP]; 8];
        for i in 0..GROUP {
            let [fx, fy, fz] = [0, 1, 2].map(|axis| self.fraction[axis][i]);
            let (gx, gy, gz) = (1.0 - fx, 1.0 - fy, 1.0 - fz);
            let (a, b, c, d) = (gy * gz, fy * gz, gy * fz, fy * fz);
            out[0][i] = gx * a;
            out[1][i] = fx * a;
            out[2][i] = gx * b;
            out[3][i] = fx * b;
            out[4][i] = gx * c;
            out[5][i] = fx * c;
            out[6][i] = gx * d;
            out[7][i] = fx * d;
        }
        out
    }
}

/// Adds a level's raw densities at the first `count` positions, and marks the positions where it stores anything.
#[inline(always)]
pub(crate) fn add_raw_densities(
    level: &Lattice,
    at: &Positions,
    count: usize,
    raw: &mut Lane<f32>,
    stored: &mut Lane<bool>,
) {
    let places = Places::of(level, at);
    let weights = places.weights();
    let (index, density) = (level.index(), level.density());
    for i in 0..count {
        let Some(nodes) = places.nodes(i, index) else {
            continue;
        };
        stored[i] = true;
        let mut sum = 0.0;
        for (node, weights) in nodes.iter().zip(&weights) {
            sum += density[*node as usize] * weights[i];
        }
        raw[i] += sum;
    }
}

dispatch!(
    /// Replaces `rows` by the features at `positions`, padded with zeros: `[position][16]`.
    pub(crate) fn gather_features => gather_generic(
        field: &Field,
        positions: &[Vec3],
        rows: &mut Vec<f32>,
    )
);

#[inline(always)]
fn gather_generic<L: Lanes, const R: usize, const V: usize>(
    field: &Field,
    positions: &[Vec3],
    rows: &mut Vec<f32>,
) {
    rows.clear();
    rows.resize(positions.len() * PADDED_FEATURES, 0.0);
    let groups = rows.chunks_mut(GROUP * PADDED_FEATURES);
    for (points, rows) in positions.chunks(GROUP).zip(groups) {
        let mut at = Positions::ZERO;
        for (i, p) in points.iter().enumerate() {
            at.set(i, *p);
        }
        for level in &field.levels {
            add_features(level, &at, rows);
        }
    }
}

/// Adds a level's features at the first positions to rows of [`PADDED_FEATURES`], one for each.
#[inline(always)]
fn add_features(level: &Lattice, at: &Positions, rows: &mut [f32]) {
    let places = Places::of(level, at);
    let weights = places.weights();
    let (index, features) = (level.index(), level.features());
    for (i, row) in rows.chunks_exact_mut(PADDED_FEATURES).enumerate() {
        let Some(nodes) = places.nodes(i, index) else {
            continue;
        };
        let row: &mut [f32; FEATURES] = row.first_chunk_mut().expect("a row holds all features");
        let mut sums = *row;
        for (node, weights) in nodes.iter().zip(&weights) {
            let node = &features[*node as usize];
            for f in 0..FEATURES {
                sums[f] += node[f] * weights[i];
            }
        }
        *row = sums;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::backend::cpu::Simd;
    use crate::field::{ColorMlp, DensityActivation, Occupancy};
    use crate::scene::Draws;

    /// Two levels with holes, so that positions lie inside bricks, across their faces, beside missing ones and outside.
    fn field() -> Field {
        let mut draws = Draws::new(11, 0, 0);
        let (low, high) = (Vec3::splat(-2.0), Vec3::splat(2.0));
        let level = |voxel_m: f32, every: u32, draws: &mut Draws| {
            let mut level = Lattice::new(voxel_m, low, high - low).expect("a small box");
            let bricks = level.bricks_per_axis();
            for number in 0..bricks.element_product() {
                let at = [
                    number % bricks.x,
                    number / bricks.x % bricks.y,
                    number / (bricks.x * bricks.y),
                ];
                if number % every == 0 {
                    level.allocate(at.map(|c| c as u16));
                }
            }
            let (density, features) = level.parameters_mut();
            for value in density[BRICK_NODES..]
                .iter_mut()
                .chain(features[BRICK_NODES..].as_flattened_mut())
            {
                *value = draws.jitter(1.0) as f32;
            }
            level
        };
        Field {
            bounds_m: (low, high),
            levels: vec![level(0.25, 2, &mut draws), level(0.125, 3, &mut draws)],
            activation: DensityActivation::from_alpha(0.1, 0.1),
            mlp: ColorMlp::new(16, || 0.5),
            sky: None,
            occupancy: Occupancy::new(0.25, low, high - low).expect("a small box"),
            step_growth: 0.0,
        }
    }

    #[test]
    fn groups_read_what_single_positions_read_on_every_path() {
        let field = field();
        let mut draws = Draws::new(12, 0, 0);
        let mut points: Vec<Vec3> = (0..1000)
            .map(|_| Vec3::from([(); 3].map(|()| draws.jitter(2.2) as f32)))
            .collect();
        points.extend([Vec3::NAN, Vec3::splat(-2.0), Vec3::splat(2.0)]);
        for simd in Simd::available() {
            let mut rows = Vec::new();
            gather_features(simd, &field, &points, &mut rows);
            for (p, row) in points.iter().zip(rows.chunks_exact(PADDED_FEATURES)) {
                assert_eq!(row[..FEATURES], field.features(*p), "{simd:?} {p}");
            }
        }
        for group in points.chunks(GROUP) {
            let mut at = Positions::ZERO;
            group.iter().enumerate().for_each(|(i, p)| at.set(i, *p));
            let (mut raw, mut stored) = ([0.0; GROUP], [false; GROUP]);
            for level in &field.levels {
                add_raw_densities(level, &at, group.len(), &mut raw, &mut stored);
                let places = Places::of(level, &at);
                for (i, p) in group.iter().enumerate() {
                    let expected = level.corners(*p).map_or(vec![], |corners| {
                        let mut bricks = corners.nodes.map(|n| n / BRICK_NODES as u32).to_vec();
                        bricks.retain(|brick| *brick != NULL_BRICK);
                        bricks.sort_unstable();
                        bricks.dedup();
                        bricks
                    });
                    let (bricks, count) = places.bricks(i, level.index());
                    let mut bricks = bricks[..count].to_vec();
                    bricks.sort_unstable();
                    assert_eq!(bricks, expected, "{p}");
                }
            }
            for (i, p) in group.iter().enumerate() {
                assert_eq!(raw[i], field.raw_density(*p), "{p}");
                assert_eq!(stored[i], field.sigma(*p) > 0.0, "{p}");
            }
        }
    }
}
