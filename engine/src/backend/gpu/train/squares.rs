//! Mean squared gradients of a level's nodes, kept on the host while its bricks change.

use crate::field::BRICK_NODES;

#[derive(Clone, Debug, Default)]
pub(super) struct LevelSquares {
    pub(super) density: Vec<f32>,
    pub(super) features: Vec<f32>,
}

impl LevelSquares {
    pub(super) fn resize(&mut self, nodes: usize) {
        self.density.resize(nodes, 0.0);
        self.features.resize(nodes, 0.0);
    }

    /// Follows [`crate::field::Lattice::retain`].
    pub(super) fn retain(&mut self, old_of_new: &[u32]) {
        for squares in [&mut self.density, &mut self.features] {
            for (new, old) in old_of_new.iter().enumerate() {
                let from = *old as usize * BRICK_NODES;
                squares.copy_within(from..from + BRICK_NODES, new * BRICK_NODES);
            }
            squares.truncate(old_of_new.len() * BRICK_NODES);
        }
    }
}
