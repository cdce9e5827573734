//! One bit per grid node: whether anything may be there. A point asks its nearest node.

use glam::{UVec3, Vec3};

use super::grid::Shape;
use super::resample::same_place;
use crate::field::BRICK_SIDE;

/// The bits of a grid, in blocks of 8^3 nodes that fall together with its bricks.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct NodeMask {
    nodes: UVec3,
    blocks: UVec3,
    /// Word z, bit `y * 8 + x`.
    words: Vec<[u64; BRICK_SIDE]>,
    /// Whether a block has any bit, one byte each: the first thing a ray asks.
    any: Vec<bool>,
}

/// What a ray meets at a point.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Bit {
    Set,
    Clear,
    /// Nor has any node of this block one.
    ClearBlock(UVec3),
}

impl NodeMask {
    pub(super) fn new(shape: &Shape, mut set: impl FnMut(UVec3) -> bool) -> Self {
        let mut mask = Self {
            nodes: shape.nodes,
            blocks: shape.bricks,
            words: vec![[0; BRICK_SIDE]; shape.brick_count()],
            any: Vec::new(),
        };
        shape.for_each_node(|node, _| {
            if set(node) {
                let (block, word, bit) = mask.place(node);
                mask.words[block][word] |= 1 << bit;
            }
        });
        mask.any = mask.words.iter().map(|w| *w != [0; BRICK_SIDE]).collect();
        mask
    }

    /// Nodes whose raw density, or that of one of their 26 neighbours, exceeds `raw_min`: max pooling commutes with the
    /// monotone activation.
    pub(super) fn dense(shape: &Shape, density: &[f32], raw_min: f32) -> Self {
        let size = shape.nodes.as_usizevec3();
        let mut flat = vec![false; size.element_product()];
        let strides = [1, size.x, size.x * size.y];
        shape.for_each_node(|node, at| {
            let node = node.as_usizevec3();
            flat[node.x + node.y * strides[1] + node.z * strides[2]] = density[at] > raw_min;
        });
        for (axis, stride) in strides.into_iter().enumerate() {
            let old = flat.clone();
            for (at, out) in flat.iter_mut().enumerate() {
                let along = at / stride % size[axis];
                *out |= along > 0 && old[at - stride] || along + 1 < size[axis] && old[at + stride];
            }
        }
        Self::new(shape, |node| {
            let node = node.as_usizevec3();
            flat[node.x + node.y * strides[1] + node.z * strides[2]]
        })
    }

    /// The bits that both masks have.
    pub(super) fn and(mut self, other: &Self) -> Self {
        assert_eq!(self.nodes, other.nodes, "masks of one grid");
        for (words, others) in self.words.iter_mut().zip(&other.words) {
            words.iter_mut().zip(others).for_each(|(a, b)| *a &= b);
        }
        self.any = self.words.iter().map(|w| *w != [0; BRICK_SIDE]).collect();
        self
    }

    /// This mask, of grid `from`, at the nodes of `to` over the same box.
    pub(super) fn resampled(&self, from: &Shape, to: &Shape) -> Self {
        Self::new(to, |node| self.near(same_place(from, to, node)))
    }

    /// The bit of the node nearest to `q` in node coordinates; clear outside.
    pub(super) fn near(&self, q: Vec3) -> bool {
        let inside = q.cmpge(Vec3::splat(-0.5)).all();
        let node = nearest(q);
        inside && node.cmplt(self.nodes).all() && self.bit(node) == Bit::Set
    }

    /// Every block's bits, as 16 words of which bit `(z * 8 + y) * 8 + x` is that of its node (x, y, z), in the grid's order of bricks.
    #[cfg(feature = "gpu")]
    pub(crate) fn blocks(&self) -> impl Iterator<Item = [u32; 16]> {
        self.words
            .iter()
            .map(|layers| std::array::from_fn(|i| (layers[i / 2] >> (32 * (i % 2))) as u32))
    }

    #[inline(always)]
    pub(super) fn bit(&self, node: UVec3) -> Bit {
        let (block, word, bit) = self.place(node);
        if !self.any[block] {
            Bit::ClearBlock(node >> 3u32)
        } else if self.words[block][word] >> bit & 1 == 1 {
            Bit::Set
        } else {
            Bit::Clear
        }
    }

    #[inline(always)]
    fn place(&self, node: UVec3) -> (usize, usize, u32) {
        let block = node >> 3u32;
        let at = (block.z * self.blocks.y + block.y) * self.blocks.x + block.x;
        let local = node & 7u32;
        (at as usize, local.z as usize, local.y * 8 + local.x)
    }
}

/// The node nearest to `q`, whose coordinates are at least -0.5.
#[inline(always)]
pub(super) fn nearest(q: Vec3) -> UVec3 {
    (q + 0.5).as_uvec3()
}
