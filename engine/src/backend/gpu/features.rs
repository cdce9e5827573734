//! Colour features in device buffers: three quads a node, each quad in buffers of its own, so that few outgrow a binding.

use super::error::Error;
use super::parts::Parts;
use super::transfer::{NODES_PER_COPY, Transfer};
use crate::field::{BRICK_NODES, FEATURES, Lattice};

pub(super) type Quad = [f32; 4];

/// Quads of a node.
pub(super) const QUADS: usize = FEATURES / 4;

/// Parts are gathered one after the other: more would be slower than the processor.
const MOST_PARTS: usize = 32;

const LABELS: [&str; QUADS] = ["features 0 to 3", "features 4 to 7", "features 8 to 11"];

/// All features of all levels, levels one after the other with one null brick before them, as the bricks are numbered.
///
/// # Errors
/// [`Error::TooLarge`] or [`Error::OutOfMemory`] where they do not fit, and those of [`Transfer::go_on`].
pub(super) fn upload(
    upload: Transfer<'_>,
    levels: &[Lattice],
) -> Result<[Parts<Quad>; QUADS], Error> {
    Ok([
        quad(upload, levels, 0)?,
        quad(upload, levels, 1)?,
        quad(upload, levels, 2)?,
    ])
}

fn quad(upload: Transfer<'_>, levels: &[Lattice], number: usize) -> Result<Parts<Quad>, Error> {
    let device = upload.device;
    let quads = Parts::zeroed(device, LABELS[number], node_count(levels), MOST_PARTS)?;
    let mut at = BRICK_NODES;
    let mut values = Vec::with_capacity(NODES_PER_COPY);
    for level in levels {
        for part in level.features()[BRICK_NODES..].chunks(NODES_PER_COPY) {
            values.clear();
            values.extend(part.iter().map(|node| node.as_chunks::<4>().0[number]));
            quads.write(device, at, &values);
            at += part.len();
            upload.go_on()?;
        }
    }
    Ok(quads)
}

/// Nodes of all levels under one numbering, whose first brick is the null brick of each.
pub(super) fn node_count(levels: &[Lattice]) -> usize {
    let stored = levels
        .iter()
        .map(|level| level.density().len() - BRICK_NODES);
    BRICK_NODES + stored.sum::<usize>()
}
