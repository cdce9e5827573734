//! Values that may outgrow a binding, in as few buffers as hold them.

use bytemuck::{AnyBitPattern, NoUninit};
use wgpu::BufferUsages;

use super::buffer::Buffer;
use super::device::Device;
use super::error::Error;
use crate::field::BRICK_NODES;

/// Bytes of the largest value of a node, a quad of features.
const QUAD_BYTES: usize = size_of::<[f32; 4]>();

/// Values by node, in one buffer or in several of [`Self::nodes_per_part`] values each.
#[derive(Debug)]
pub(super) struct Parts<T> {
    parts: Vec<Buffer<T>>,
    nodes_per_part: usize,
    nodes: usize,
}

/// Nodes of each part: all if a binding holds them, else as many times the whole bricks of quads that it holds as smaller values allow. So
/// every part of quads lies within one part of the smaller values.
///
/// # Errors
/// [`Error::TooLarge`] if that takes more than `most_parts`.
pub(super) fn nodes_per_part(
    what: &'static str,
    nodes: usize,
    node_bytes: usize,
    binding_bytes: u64,
    most_parts: usize,
) -> Result<usize, Error> {
    let fit = (binding_bytes / node_bytes as u64) as usize;
    if nodes <= fit {
        return Ok(nodes.max(1));
    }
    let whole_quads = binding_bytes as usize / QUAD_BYTES / BRICK_NODES * BRICK_NODES;
    let whole = whole_quads * (QUAD_BYTES / node_bytes);
    if whole == 0 || nodes.div_ceil(whole) > most_parts {
        return Err(Error::TooLarge {
            what,
            needed_bytes: nodes as u64 * node_bytes as u64,
            available_bytes: (whole * node_bytes) as u64 * most_parts as u64,
        });
    }
    Ok(whole)
}

impl<T: NoUninit + AnyBitPattern> Parts<T> {
    /// Zeros for `nodes`.
    ///
    /// # Errors
    /// [`Error::TooLarge`] if they take more than `most_parts` bindings; [`Error::OutOfMemory`] where the device is full.
    pub(super) fn zeroed(
        device: &Device,
        what: &'static str,
        nodes: usize,
        most_parts: usize,
    ) -> Result<Self, Error> {
        let binding = device.max_binding_bytes();
        let nodes_per_part = nodes_per_part(what, nodes, size_of::<T>(), binding, most_parts)?;
        Self::divided(device, what, nodes, nodes_per_part)
    }

    /// Zeros for `nodes` in parts of `nodes_per_part`.
    ///
    /// # Errors
    /// As [`Self::zeroed`].
    pub(super) fn divided(
        device: &Device,
        what: &'static str,
        nodes: usize,
        nodes_per_part: usize,
    ) -> Result<Self, Error> {
        let mut parts = Vec::new();
        for start in (0..nodes.max(1)).step_by(nodes_per_part) {
            let own = nodes_per_part.min(nodes.max(1) - start);
            parts.push(Buffer::zeroed(device, what, own, BufferUsages::STORAGE)?);
        }
        Ok(Self {
            parts,
            nodes_per_part,
            nodes,
        })
    }

    /// Nodes that have a value.
    pub(super) fn nodes(&self) -> usize {
        self.nodes
    }

    /// The buffer that holds a node's value, and the node that is its first.
    pub(super) fn holding(&self, node: usize) -> (&Buffer<T>, usize) {
        let part = node / self.nodes_per_part;
        (&self.parts[part], part * self.nodes_per_part)
    }

    /// The values of `len` nodes from node `at` on; waits for the device.
    ///
    /// # Errors
    /// As [`Buffer::read`].
    pub(super) fn read(&self, device: &Device, at: usize, len: usize) -> Result<Vec<T>, Error> {
        let mut values = Vec::with_capacity(len);
        while values.len() < len {
            let at = at + values.len();
            let (part, first) = self.holding(at);
            let count = (len - values.len()).min(first + part.len() - at);
            values.extend(part.read_at(device, at - first, count)?);
        }
        Ok(values)
    }

    /// Overwrites the values from node `at` on.
    pub(super) fn write(&self, device: &Device, mut at: usize, mut values: &[T]) {
        while !values.is_empty() {
            let (part, within) = (at / self.nodes_per_part, at % self.nodes_per_part);
            let count = values.len().min(self.nodes_per_part - within);
            let (own, rest) = values.split_at(count);
            self.parts[part].write_at(device, within, own);
            (at, values) = (at + count, rest);
        }
    }

    /// The buffers, first nodes first.
    pub(super) fn parts(&self) -> &[Buffer<T>] {
        &self.parts
    }

    pub(super) fn nodes_per_part(&self) -> usize {
        self.nodes_per_part
    }

    pub(super) fn bytes(&self) -> u64 {
        self.parts.iter().map(Buffer::bytes).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LAVAPIPE: u64 = 128 << 20;
    /// 330^3 nodes, in whole bricks.
    const DENSE: usize = 74_088 * BRICK_NODES;

    fn split(node_bytes: usize, binding: u64, most: usize) -> Result<usize, Error> {
        nodes_per_part("nodes", DENSE, node_bytes, binding, most)
    }

    #[test]
    fn a_dense_background_is_whole_where_it_fits_and_split_where_not() {
        assert_eq!(split(4, 2 << 30, 4).unwrap(), DENSE);
        assert_eq!(split(16, 2 << 30, 64).unwrap(), DENSE);
        let density = split(4, LAVAPIPE, 4).unwrap();
        assert_eq!(DENSE.div_ceil(density), 2);
        let features = split(16, LAVAPIPE, 64).unwrap();
        assert_eq!(DENSE.div_ceil(features), 5);
        assert!(density.is_multiple_of(features));
        // Not a whole number of bricks a binding.
        let odd = (1 << 20) + 5_000;
        assert_eq!(
            split(4, odd, 2000).unwrap(),
            4 * split(16, odd, 2000).unwrap()
        );
        for (nodes, bytes) in [(density, 4), (features, 16)] {
            assert!(nodes % BRICK_NODES == 0 && (nodes * bytes) as u64 <= LAVAPIPE);
        }
    }

    #[test]
    fn what_fits_nowhere_says_what_it_needs_and_what_there_is() {
        let refused = split(4, 32 << 20, 4).unwrap_err();
        let Error::TooLarge {
            needed_bytes,
            available_bytes,
            ..
        } = refused
        else {
            panic!("{refused}");
        };
        assert_eq!(needed_bytes, DENSE as u64 * 4);
        assert_eq!(available_bytes, 128 << 20);
        assert!(split(4, 1024, 1000).is_err(), "not even a brick");
    }
}
