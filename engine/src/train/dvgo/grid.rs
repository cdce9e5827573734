//! A dense grid over a box, stored in bricks.
//!
//! Node (x, y, z) is at `low + spacing * (x, y, z)`; the corners of the box are nodes. Values lie in bricks of 8^3 nodes as in
//! [`crate::field::Lattice`], which keeps the eight neighbours of a point within a few pages. Because every brick is stored, the
//! place of a node is a sum of one term per axis, and no index is needed.

use glam::{DVec3, UVec3, Vec3};

use crate::backend::cpu::prefetch::prefetch;
use crate::field::{BRICK_NODES, BRICK_SIDE};

const SIDE: u32 = BRICK_SIDE as u32;

/// Size and place of a grid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Shape {
    /// Nodes per axis, at least 2.
    pub(crate) nodes: UVec3,
    pub(crate) low: DVec3,
    pub(crate) high: DVec3,
    /// Bricks per axis.
    pub(crate) bricks: UVec3,
}

/// The eight nodes around a point, per axis, and where between them it lies.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Cell {
    x: [u32; 2],
    y: [u32; 2],
    z: [u32; 2],
    pub(super) fraction: Vec3,
}

impl Shape {
    pub(super) fn new(nodes: UVec3, (low, high): (DVec3, DVec3)) -> Self {
        assert!(nodes.min_element() >= 2, "a grid has two nodes per axis");
        Self {
            nodes,
            low,
            high,
            bricks: (nodes + SIDE - 1) / SIDE,
        }
    }

    /// Stored values, those beyond the last nodes included.
    pub(crate) fn len(&self) -> usize {
        self.brick_count() * BRICK_NODES
    }

    pub(crate) fn brick_count(&self) -> usize {
        self.bricks.element_product() as usize
    }

    /// Distance between nodes in metres.
    pub(crate) fn spacing_m(&self) -> DVec3 {
        (self.high - self.low) / (self.nodes - 1).as_dvec3()
    }

    pub(super) fn place(&self, node: UVec3) -> DVec3 {
        self.low + self.spacing_m() * node.as_dvec3()
    }

    /// Position of a node's value.
    #[inline(always)]
    pub(super) fn at(&self, node: UVec3) -> usize {
        let [x, y, z] = self.terms(node);
        (x + y + z) as usize
    }

    #[inline(always)]
    fn terms(&self, node: UVec3) -> [u32; 3] {
        const BRICK: u32 = BRICK_NODES as u32;
        let row = BRICK * self.bricks.x;
        let layer = row * self.bricks.y;
        [
            (node.x >> 3) * BRICK + (node.x & 7),
            (node.y >> 3) * row + (node.y & 7) * SIDE,
            (node.z >> 3) * layer + (node.z & 7) * SIDE * SIDE,
        ]
    }

    /// The cell of a point in node coordinates, which must lie within `0..=nodes - 1`.
    #[inline(always)]
    pub(super) fn cell(&self, q: Vec3) -> Cell {
        let base = q.as_uvec3().min(self.nodes - 2);
        let (near, far) = (self.terms(base), self.terms(base + 1));
        Cell {
            x: [near[0], far[0]],
            y: [near[1], far[1]],
            z: [near[2], far[2]],
            fraction: q - base.as_vec3(),
        }
    }

    /// Calls `visit` for every node, in storage order, with the position of its value.
    pub(super) fn for_each_node(&self, mut visit: impl FnMut(UVec3, usize)) {
        for brick in 0..self.brick_count() {
            let first = self.brick_position(brick) * SIDE;
            for local in 0..BRICK_NODES {
                let node = first + local_position(local);
                if node.cmplt(self.nodes).all() {
                    visit(node, brick * BRICK_NODES + local);
                }
            }
        }
    }

    /// Position of brick number `brick` in bricks.
    pub(super) fn brick_position(&self, brick: usize) -> UVec3 {
        let (brick, bricks) = (brick as u32, self.bricks);
        UVec3::new(
            brick % bricks.x,
            brick / bricks.x % bricks.y,
            brick / (bricks.x * bricks.y),
        )
    }
}

/// Position within its brick of the value number `local`.
pub(super) fn local_position(local: usize) -> UVec3 {
    let local = local as u32;
    UVec3::new(local & 7, local >> 3 & 7, local >> 6)
}

impl Cell {
    /// Positions of the eight values; corner `c` has bit 0 for x, 1 for y, 2 for z.
    #[inline(always)]
    pub(super) fn corners(&self) -> [u32; 8] {
        let [a, b] = self.x;
        let near = [self.y[0] + self.z[0], self.y[1] + self.z[0]];
        let far = [self.y[0] + self.z[1], self.y[1] + self.z[1]];
        [
            a + near[0],
            b + near[0],
            a + near[1],
            b + near[1],
            a + far[0],
            b + far[0],
            a + far[1],
            b + far[1],
        ]
    }

    /// Asks for all that [`Self::interpolate`] reads; the pairs along x mostly share a cache line.
    #[inline(always)]
    pub(super) fn prefetch_values(&self, values: &[f32]) {
        let corners = self.corners();
        for pair in corners.chunks_exact(2) {
            prefetch(values, pair[0] as usize);
        }
    }

    /// Asks for all that [`Self::interpolate_rows`] reads.
    #[inline(always)]
    pub(super) fn prefetch_rows<const C: usize>(&self, values: &[[f32; C]]) {
        let values = values.as_flattened();
        for pair in self.corners().chunks_exact(2) {
            let (first, last) = (pair[0] as usize * C, pair[1] as usize * C);
            prefetch(values, first);
            if C > 4 {
                prefetch(values, first + C - 1);
                prefetch(values, last + C - 1);
            }
        }
    }

    /// Trilinear weights in the order of [`Self::corners`].
    #[inline(always)]
    pub(super) fn weights(&self) -> [f32; 8] {
        trilinear(self.fraction)
    }

    #[inline(always)]
    pub(super) fn interpolate(&self, values: &[f32]) -> f32 {
        // A loop, because `map`'s insides are not inlined into code for other instruction sets.
        let mut v = [0.0; 8];
        for (value, at) in v.iter_mut().zip(self.corners()) {
            *value = values[at as usize];
        }
        let f = self.fraction;
        let mix = |a: f32, b: f32, t: f32| a + t * (b - a);
        let near = mix(mix(v[0], v[1], f.x), mix(v[2], v[3], f.x), f.y);
        let far = mix(mix(v[4], v[5], f.x), mix(v[6], v[7], f.x), f.y);
        mix(near, far, f.z)
    }

    #[inline(always)]
    pub(super) fn interpolate_rows<const C: usize>(&self, values: &[[f32; C]]) -> [f32; C] {
        let mut sum = [0.0; C];
        for (at, weight) in self.corners().into_iter().zip(self.weights()) {
            let row = &values[at as usize];
            for (sum, value) in sum.iter_mut().zip(row) {
                *sum += weight * value;
            }
        }
        sum
    }
}

/// Weights of a cell's corners at a point between them.
#[inline(always)]
pub(super) fn trilinear(f: Vec3) -> [f32; 8] {
    let g = Vec3::ONE - f;
    let (a, b, c, d) = (g.y * g.z, f.y * g.z, g.y * f.z, f.y * f.z);
    [
        g.x * a,
        f.x * a,
        g.x * b,
        f.x * b,
        g.x * c,
        f.x * c,
        g.x * d,
        f.x * d,
    ]
}
