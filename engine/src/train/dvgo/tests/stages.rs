//! Small stages with all sorts of values, for comparing backends.

use glam::{DVec3, UVec3};

use super::scene::views;
use crate::field::ColorMlp;
use crate::field::lattice::FEATURES;
use crate::scene::Draws;
use crate::train::dvgo::finish::cubic_box;
use crate::train::dvgo::grid::Shape;
use crate::train::dvgo::mask::NodeMask;
use crate::train::dvgo::network::initial_network;
use crate::train::dvgo::pixels::{Choice, PixelRay, Pixels};
use crate::train::dvgo::stage::{Stage, resolution};
use crate::train::dvgo::{DvgoRecipe, GridRecipe, StepRecipe};

/// A stage of the first kind: direct colours, and rates of its own for every node's density.
pub(crate) fn coarse() -> Stage<4> {
    let recipe = DvgoRecipe::default();
    let mut stage = stage(recipe.coarse_grid, recipe.coarse, None);
    let mut draws = Draws::new(12, 0, 0);
    stage.density_shares = stage.density.iter().map(|_| draws.unit() as f32).collect();
    stage.colors.iter_mut().for_each(|node| node[3] = 0.0);
    stage
}

/// A stage of the second kind: features and a network.
pub(crate) fn fine() -> Stage<FEATURES> {
    let recipe = DvgoRecipe::default();
    let mut draws = Draws::new(13, 0, 0);
    let mlp = initial_network(32, || draws.unit());
    stage(recipe.fine_grid, recipe.fine, Some(mlp))
}

/// Three bricks and a part of one per axis: a fuzzy ball with clouds around it in a mask that is a larger ball.
fn stage<const C: usize>(grid: GridRecipe, steps: StepRecipe, mlp: Option<ColorMlp>) -> Stage<C> {
    let bounds = (DVec3::new(-1.0, -0.7, -0.9), DVec3::new(0.8, 0.9, 1.0));
    let (voxel_m, nodes) = resolution(bounds, 26 * 26 * 26);
    let shape = Shape::new(nodes, cubic_box(bounds, nodes));
    let mask = NodeMask::new(&shape, |node| shape.place(node).length() < 1.0);
    let sizes = (voxel_m, voxel_m);
    let steps = StepRecipe {
        rays: RAYS,
        ..steps
    };
    let mut stage = Stage::new((grid, steps), shape, sizes, mask, mlp, [1.0, 0.9, 0.8]);
    let mut draws = Draws::new(11, 0, 0);
    let shift = stage.activation.act_shift;
    shape.for_each_node(|node: UVec3, at| {
        let inside = shape.place(node).length() < 0.55;
        // Opacities of a voxel: a tenth and more, or anything from below the threshold to a twentieth.
        let thin = grid.alpha_min.ln() - 2.0;
        let (low, high) = if inside { (-2.0, 2.0) } else { (thin, -3.0) };
        stage.density[at] = draws.uniform(low, high) as f32 - shift;
        stage.colors[at] = std::array::from_fn(|_| draws.uniform(-1.0, 1.0) as f32);
    });
    stage
}

/// Rays of a step of these stages.
pub(crate) const RAYS: usize = 160;

/// A step's rays from all around.
pub(crate) fn rays(step: u64) -> Vec<PixelRay> {
    let views = views(6, 0, 24);
    let pixels = Pixels::new(&views, 3.0);
    let mut rays = Vec::new();
    pixels.draw(&Choice::Random, (3, step), RAYS, &mut rays);
    rays
}
