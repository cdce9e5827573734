//! One level of the field: a brick-sparse lattice of node values with trilinear interpolation.
//!
//! Space is divided into bricks of 8^3 nodes. A dense index maps each brick position to a stored brick; brick 0 is the null
//! brick, all zeros and never trained, and stands for every brick that is not stored. A level therefore contributes 0 where
//! nothing is allocated, and allocating a zero brick changes no value: refinement is continuous and needs no resampling.

use std::fmt;

use glam::{IVec3, UVec3, Vec3};

/// Nodes along each edge of a brick.
pub const BRICK_SIDE: usize = 8;
/// Nodes of a brick; node (x, y, z) is at `(z * 8 + y) * 8 + x`.
pub const BRICK_NODES: usize = BRICK_SIDE * BRICK_SIDE * BRICK_SIDE;
/// Colour features per node, stored node-major: 3 x vec4.
pub const FEATURES: usize = 12;
/// The all-zero brick that stands for missing ones.
pub const NULL_BRICK: u32 = 0;
/// Bound on index cells: 256 MiB of index would mean a box far too large for its voxels.
const MAX_INDEX_CELLS: u64 = 64 << 20;

/// The eight nodes around a position and their trilinear weights.
#[derive(Clone, Copy, Debug)]
pub struct Corners {
    /// Indices into [`Lattice::density`] and [`Lattice::features`]; corner `c` has bit 0 for x, 1 for y, 2 for z.
    pub nodes: [u32; 8],
    pub weights: [f32; 8],
}

/// A level's values, borrowed for change. The first 512 of each array are the null brick's and must stay 0.
#[derive(Debug)]
pub(crate) struct PlacedParameters<'a> {
    pub(crate) voxel_m: f32,
    pub(crate) origin_m: Vec3,
    pub(crate) positions: &'a [[u16; 3]],
    pub(crate) density: &'a mut [f32],
    pub(crate) features: &'a mut [[f32; FEATURES]],
}

/// A brick-sparse lattice level.
#[derive(Clone, PartialEq)]
pub struct Lattice {
    voxel_m: f32,
    nodes_per_m: f32,
    origin_m: Vec3,
    /// Brick positions per axis. The index has one more layer per axis, always null, for the upper corners.
    bricks: UVec3,
    index: Vec<u32>,
    /// Brick position of every stored brick; entry 0 belongs to the null brick and means nothing.
    positions: Vec<[u16; 3]>,
    density: Vec<f32>,
    features: Vec<[f32; FEATURES]>,
}

impl Lattice {
    /// An empty level covering `size_m` from `origin_m` on. `None` if the brick index would be unreasonably large.
    pub fn new(voxel_m: f32, origin_m: Vec3, size_m: Vec3) -> Option<Self> {
        let brick_m = voxel_m * BRICK_SIDE as f32;
        let span = (size_m / brick_m).ceil();
        let countable =
            size_m.is_finite() && span.is_finite() && span.max_element() < f32::from(u16::MAX);
        countable
            .then(|| Self::with_bricks(voxel_m, origin_m, span.as_uvec3().max(UVec3::ONE)))
            .flatten()
    }

    /// An empty level of `bricks` brick positions per axis. `None` if the brick index would be unreasonably large.
    pub fn with_bricks(voxel_m: f32, origin_m: Vec3, bricks: UVec3) -> Option<Self> {
        let cells = (bricks.as_dvec3() + 1.0).element_product();
        let sound = voxel_m > 0.0
            && voxel_m.is_finite()
            && origin_m.is_finite()
            && bricks.min_element() > 0
            && bricks.max_element() < u32::from(u16::MAX)
            && cells <= MAX_INDEX_CELLS as f64;
        sound.then(|| Self {
            voxel_m,
            nodes_per_m: 1.0 / voxel_m,
            origin_m,
            bricks,
            index: vec![NULL_BRICK; cells as usize],
            positions: vec![[0; 3]],
            density: vec![0.0; BRICK_NODES],
            features: vec![[0.0; FEATURES]; BRICK_NODES],
        })
    }

    pub fn voxel_m(&self) -> f32 {
        self.voxel_m
    }

    pub(crate) fn nodes_per_m(&self) -> f32 {
        self.nodes_per_m
    }

    /// Nodes along each axis: where positions in nodes leave the level.
    pub(crate) fn nodes_per_axis(&self) -> Vec3 {
        (self.bricks * BRICK_SIDE as u32).as_vec3()
    }

    /// Steps of the index along y and z.
    pub(crate) fn index_strides(&self) -> [u32; 2] {
        let row = self.bricks.x + 1;
        [row, row * (self.bricks.y + 1)]
    }

    pub fn brick_m(&self) -> f32 {
        self.voxel_m * BRICK_SIDE as f32
    }

    /// Position of node (0, 0, 0).
    pub fn origin_m(&self) -> Vec3 {
        self.origin_m
    }

    /// Brick positions per axis.
    pub fn bricks_per_axis(&self) -> UVec3 {
        self.bricks
    }

    /// Stored bricks including the null brick.
    pub fn brick_count(&self) -> usize {
        self.positions.len()
    }

    /// The dense brick index, x fastest, `bricks_per_axis() + 1` cells per axis.
    pub fn index(&self) -> &[u32] {
        &self.index
    }

    /// Raw densities, `brick_count() * 512`.
    pub fn density(&self) -> &[f32] {
        &self.density
    }

    /// Colour features, `brick_count() * 512`.
    pub fn features(&self) -> &[[f32; FEATURES]] {
        &self.features
    }

    /// Raw densities and features. The first 512 entries of each are the null brick's and must stay 0.
    pub fn parameters_mut(&mut self) -> (&mut [f32], &mut [[f32; FEATURES]]) {
        (&mut self.density, &mut self.features)
    }

    /// The parameter arrays with what places them in space, for the optimiser.
    pub(crate) fn placed_parameters_mut(&mut self) -> PlacedParameters<'_> {
        PlacedParameters {
            voxel_m: self.voxel_m,
            origin_m: self.origin_m,
            positions: &self.positions,
            density: &mut self.density,
            features: &mut self.features,
        }
    }

    /// Brick positions of all stored bricks; entry 0 is the null brick's and means nothing.
    pub fn positions(&self) -> &[[u16; 3]] {
        &self.positions
    }

    /// Lower corner of a brick position, i.e. of its first node, in metres.
    pub fn brick_origin(&self, position: [u16; 3]) -> Vec3 {
        self.origin_m + Vec3::from(position.map(f32::from)) * self.brick_m()
    }

    /// The brick position that holds `p`, if inside the level.
    pub fn brick_at(&self, p: Vec3) -> Option<[u16; 3]> {
        let q = ((p - self.origin_m) / self.brick_m()).floor();
        let inside = q.cmpge(Vec3::ZERO).all() && q.cmplt(self.bricks.as_vec3()).all();
        inside.then(|| q.as_uvec3().to_array().map(|c| c as u16))
    }

    /// The stored brick at a brick position, [`NULL_BRICK`] if none.
    pub fn brick(&self, position: [u16; 3]) -> u32 {
        let p = UVec3::from(position.map(u32::from));
        if p.cmplt(self.bricks).all() {
            self.index[self.index_cell(p)]
        } else {
            NULL_BRICK
        }
    }

    /// Stores a zero brick at `position` unless one is there. Returns its number, or `None` outside the level.
    pub fn allocate(&mut self, position: [u16; 3]) -> Option<u32> {
        let p = UVec3::from(position.map(u32::from));
        if !p.cmplt(self.bricks).all() {
            return None;
        }
        let cell = self.index_cell(p);
        if self.index[cell] == NULL_BRICK {
            self.index[cell] = self.positions.len() as u32;
            self.positions.push(position);
            self.density.resize(self.density.len() + BRICK_NODES, 0.0);
            self.features
                .resize(self.features.len() + BRICK_NODES, [0.0; FEATURES]);
        }
        Some(self.index[cell])
    }

    /// Stores a zero brick at every position that has none, x fastest.
    pub(crate) fn allocate_all(&mut self) {
        let bricks = self.bricks;
        self.reserve(bricks.as_u64vec3().element_product() as usize);
        for z in 0..bricks.z as u16 {
            for y in 0..bricks.y as u16 {
                for x in 0..bricks.x as u16 {
                    self.allocate([x, y, z]);
                }
            }
        }
    }

    /// Makes room for `additional` bricks without over-allocating.
    pub fn reserve(&mut self, additional: usize) {
        self.positions.reserve_exact(additional);
        self.density.reserve_exact(additional * BRICK_NODES);
        self.features.reserve_exact(additional * BRICK_NODES);
    }

    /// Keeps only the bricks for which `keep(brick)` holds; brick numbers change, their order does not.
    /// Returns the old number of every new brick.
    pub fn retain(&mut self, keep: impl Fn(u32) -> bool) -> Vec<u32> {
        let mut old_of_new = vec![NULL_BRICK];
        for old in 1..self.brick_count() as u32 {
            let position = self.positions[old as usize];
            let cell = self.index_cell(UVec3::from(position.map(u32::from)));
            if !keep(old) {
                self.index[cell] = NULL_BRICK;
                continue;
            }
            let new = old_of_new.len();
            self.index[cell] = new as u32;
            self.positions[new] = position;
            let from = old as usize * BRICK_NODES..(old as usize + 1) * BRICK_NODES;
            self.density.copy_within(from.clone(), new * BRICK_NODES);
            self.features.copy_within(from, new * BRICK_NODES);
            old_of_new.push(old);
        }
        let bricks = old_of_new.len();
        self.positions.truncate(bricks);
        self.density.truncate(bricks * BRICK_NODES);
        self.features.truncate(bricks * BRICK_NODES);
        old_of_new
    }

    /// The nodes and weights that interpolate at `p`; `None` outside the level or where nothing is stored.
    #[inline]
    pub fn corners(&self, p: Vec3) -> Option<Corners> {
        let q = (p - self.origin_m) * self.nodes_per_m;
        let limit = (self.bricks * BRICK_SIDE as u32).as_vec3();
        // Written so that NaN is outside.
        if !(q.cmpge(Vec3::ZERO).all() && q.cmplt(limit).all()) {
            return None;
        }
        let base = q.as_ivec3();
        let fraction = q - base.as_vec3();
        let nodes = self.corner_nodes(base)?;
        let (fx, fy, fz) = (fraction.x, fraction.y, fraction.z);
        let (gx, gy, gz) = (1.0 - fx, 1.0 - fy, 1.0 - fz);
        let (a, b, c, d) = (gy * gz, fy * gz, gy * fz, fy * fz);
        let weights = [
            gx * a,
            fx * a,
            gx * b,
            fx * b,
            gx * c,
            fx * c,
            gx * d,
            fx * d,
        ];
        Some(Corners { nodes, weights })
    }

    #[inline]
    fn corner_nodes(&self, base: IVec3) -> Option<[u32; 8]> {
        let brick = base >> 3i32;
        let local = base & 7i32;
        let stride_y = self.bricks.x as usize + 1;
        let stride_z = stride_y * (self.bricks.y as usize + 1);
        let cell = brick.x as usize + brick.y as usize * stride_y + brick.z as usize * stride_z;
        let first = ((local.z * 8 + local.y) * 8 + local.x) as u32;
        if local.max_element() < 7 {
            let stored = self.index[cell];
            if stored == NULL_BRICK {
                return None;
            }
            let n = stored * BRICK_NODES as u32 + first;
            return Some([n, n + 1, n + 8, n + 9, n + 64, n + 65, n + 72, n + 73]);
        }
        // Some corners lie in the next brick along an axis, at its node 0.
        let mut nodes = [0; 8];
        let mut any = NULL_BRICK;
        for (corner, node) in nodes.iter_mut().enumerate() {
            let step = [corner & 1, corner >> 1 & 1, corner >> 2];
            let mut at = cell;
            let mut within = 0;
            let strides = [1, stride_y, stride_z];
            for axis in 0..3 {
                let coordinate = local[axis] as usize + step[axis];
                at += (coordinate >> 3) * strides[axis];
                within += (coordinate & 7) << (3 * axis);
            }
            let stored = self.index[at];
            any |= stored;
            *node = stored * BRICK_NODES as u32 + within as u32;
        }
        (any != NULL_BRICK).then_some(nodes)
    }

    /// Interpolated raw density, 0 where nothing is stored.
    #[inline]
    pub fn raw_density(&self, p: Vec3) -> f32 {
        let Some(corners) = self.corners(p) else {
            return 0.0;
        };
        let mut sum = 0.0;
        for (node, weight) in corners.nodes.iter().zip(corners.weights) {
            sum += self.density[*node as usize] * weight;
        }
        sum
    }

    /// Adds the interpolated features to `out`.
    #[inline]
    pub fn add_features(&self, p: Vec3, out: &mut [f32; FEATURES]) {
        let Some(corners) = self.corners(p) else {
            return;
        };
        for (node, weight) in corners.nodes.iter().zip(corners.weights) {
            let features = &self.features[*node as usize];
            for (sum, feature) in out.iter_mut().zip(features) {
                *sum += feature * weight;
            }
        }
    }

    fn index_cell(&self, p: UVec3) -> usize {
        let row = self.bricks.x as usize + 1;
        (p.z as usize * (self.bricks.y as usize + 1) + p.y as usize) * row + p.x as usize
    }
}

/// Sizes only: a field is millions of values.
impl fmt::Debug for Lattice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Lattice")
            .field("voxel_m", &self.voxel_m)
            .field("bricks", &self.bricks)
            .field("brick_count", &self.brick_count())
            .finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn linear(p: Vec3) -> f32 {
        0.5 + 2.0 * p.x - 0.7 * p.y + 0.3 * p.z
    }

    fn full_level() -> Lattice {
        let mut level = Lattice::new(0.25, Vec3::new(-1.0, 2.0, 0.5), Vec3::splat(6.0)).unwrap();
        for z in 0..3 {
            for y in 0..3 {
                for x in 0..3 {
                    level.allocate([x, y, z]).unwrap();
                }
            }
        }
        for brick in 1..level.brick_count() {
            let origin = level.brick_origin(level.positions()[brick]);
            for node in 0..BRICK_NODES {
                let offset = UVec3::new(node as u32 & 7, node as u32 >> 3 & 7, node as u32 >> 6);
                let p = origin + offset.as_vec3() * level.voxel_m();
                level.density[brick * BRICK_NODES + node] = linear(p);
                level.features[brick * BRICK_NODES + node] = [linear(p) * 2.0; FEATURES];
            }
        }
        level
    }

    #[test]
    fn interpolates_a_linear_function_exactly_within_and_across_bricks() {
        let level = full_level();
        for (x, y, z) in [
            (0.1, 2.3, 0.9),
            (0.93, 3.97, 2.49),
            (2.99, 2.01, 4.4),
            (3.0, 6.0, 2.5),
        ] {
            let p = Vec3::new(x, y, z);
            assert!((level.raw_density(p) - linear(p)).abs() < 1e-4, "{p}");
            let mut features = [0.0; FEATURES];
            level.add_features(p, &mut features);
            assert!((features[11] - 2.0 * linear(p)).abs() < 1e-4, "{p}");
        }
    }

    #[test]
    fn is_zero_outside_and_where_nothing_is_stored() {
        let level = full_level();
        for p in [Vec3::ZERO, Vec3::splat(100.0), Vec3::NAN, Vec3::INFINITY] {
            assert_eq!(level.raw_density(p), 0.0);
        }
        let empty = Lattice::new(0.25, Vec3::ZERO, Vec3::splat(4.0)).unwrap();
        assert_eq!(empty.raw_density(Vec3::splat(1.0)), 0.0);
    }

    #[test]
    fn a_zero_brick_changes_no_value() {
        let mut level = Lattice::new(0.25, Vec3::ZERO, Vec3::splat(4.0)).unwrap();
        let brick = level.allocate([0, 0, 0]).unwrap() as usize;
        level.density[brick * BRICK_NODES..].fill(3.0);
        let p = Vec3::new(1.9, 0.4, 0.4);
        let before = level.raw_density(p);
        level.allocate([1, 0, 0]).unwrap();
        assert_eq!(level.raw_density(p), before);
        assert!(before > 0.0 && before < 3.0);
    }

    #[test]
    fn retain_keeps_the_values_of_what_stays() {
        let mut level = full_level();
        let p = Vec3::new(2.7, 4.2, 2.9);
        let (before, brick) = (
            level.raw_density(p),
            level.brick(level.brick_at(p).unwrap()),
        );
        let old = level.retain(|b| b >= brick);
        assert_eq!(old[1], brick);
        assert_eq!(level.raw_density(p), before);
        assert_eq!(level.raw_density(Vec3::new(-0.9, 2.1, 0.6)), 0.0);
    }

    #[test]
    fn an_unreasonable_box_is_refused() {
        assert!(Lattice::new(0.01, Vec3::ZERO, Vec3::splat(1e5)).is_none());
        assert!(Lattice::new(0.0, Vec3::ZERO, Vec3::ONE).is_none());
        assert!(Lattice::new(0.1, Vec3::ZERO, Vec3::NAN).is_none());
    }
}
