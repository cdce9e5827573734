//! A grid being trained: its values and its mask, and what changes them between steps. Steps are [`super::steps`].

use glam::{DVec3, UVec3};

use super::grid::Shape;
use super::losses::LossSetting;
use super::march::{Medium, raw_of_alpha};
use super::mask::NodeMask;
use super::recipe::{GridRecipe, StepRecipe};
use super::resample::resample;
use crate::field::{ColorMlp, DensityActivation};

/// A stage's state, up to date on the host but for what steps on a device have moved since the last fetch. C colour values per node: 3 and a
/// padding of direct colour, or 12 features.
#[derive(Debug)]
pub(crate) struct Stage<const C: usize> {
    pub(crate) grid: GridRecipe,
    pub(crate) recipe: StepRecipe,
    pub(crate) shape: Shape,
    pub(crate) density: Vec<f32>,
    pub(crate) colors: Vec<[f32; C]>,
    pub(crate) mask: NodeMask,
    pub(crate) activation: DensityActivation,
    /// The colour network of a stage that has one.
    pub(crate) mlp: Option<ColorMlp>,
    /// Factor on the density's rate at every node; empty is 1.
    pub(crate) density_shares: Vec<f32>,
    pub(crate) losses: LossSetting,
    /// Steps since the optimiser started anew.
    pub(crate) age: u64,
    voxel_m: f64,
}

/// Learning rates of a step, without bias corrections.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct DecayedRates {
    pub(crate) density: f64,
    pub(crate) color: f64,
    pub(crate) mlp: f64,
}

/// Edge of one of `voxels` equal cubes that fill the box, and the nodes along each edge of the box.
pub(super) fn resolution((low, high): (DVec3, DVec3), voxels: u64) -> (f64, UVec3) {
    let size = high - low;
    let voxel_m = (size.element_product() / voxels as f64).cbrt();
    (voxel_m, (size / voxel_m).as_uvec3().max(UVec3::splat(2)))
}

impl<const C: usize> Stage<C> {
    /// An untouched grid of `nodes` over a box, with voxels of `voxel_m` (which with the box need not fit exactly), in a mask.
    pub(super) fn new(
        (grid, recipe): (GridRecipe, StepRecipe),
        shape: Shape,
        (voxel_m, base_voxel_m): (f64, f64),
        mask: NodeMask,
        mlp: Option<ColorMlp>,
        backdrop: [f32; 3],
    ) -> Self {
        Self {
            density: vec![0.0; shape.len()],
            colors: vec![[0.0; C]; shape.len()],
            mask,
            activation: DensityActivation::from_alpha(grid.alpha_init, base_voxel_m as f32),
            mlp,
            density_shares: Vec::new(),
            losses: LossSetting::new(&recipe, backdrop),
            age: 0,
            voxel_m,
            grid,
            recipe,
            shape,
        }
    }

    pub(crate) fn step_m(&self) -> f64 {
        self.grid.step_voxels * self.voxel_m
    }

    /// Length of a voxel in base voxels.
    fn voxel_ratio(&self) -> f64 {
        self.voxel_m / f64::from(self.activation.base_voxel_m)
    }

    pub(crate) fn medium(&self) -> Medium<'_> {
        let interval = self.grid.step_voxels * self.voxel_ratio();
        Medium {
            shape: &self.shape,
            density: &self.density,
            mask: &self.mask,
            shift: self.activation.act_shift,
            interval: interval as f32,
            raw_min: self.raw_of(self.grid.alpha_min, interval),
            step_m: self.step_m() as f32,
        }
    }

    fn raw_of(&self, alpha: f64, interval: f64) -> f32 {
        raw_of_alpha(alpha, interval, f64::from(self.activation.act_shift))
    }

    /// Nodes of more opacity than `alpha` over one voxel, or beside one.
    pub(super) fn dense_nodes(&self, alpha: f64) -> NodeMask {
        let raw_min = self.raw_of(alpha, self.voxel_ratio());
        NodeMask::dense(&self.shape, &self.density, raw_min)
    }

    /// The box of the nodes of more opacity than `alpha` over one voxel.
    pub(super) fn dense_box(&self, alpha: f64) -> Option<(DVec3, DVec3)> {
        let raw_min = self.raw_of(alpha, self.voxel_ratio());
        let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        self.shape.for_each_node(|node, at| {
            if self.density[at] > raw_min {
                let p = self.shape.place(node);
                low = low.min(p);
                high = high.max(p);
            }
        });
        low.cmplt(high).all().then_some((low, high))
    }

    /// Takes out of the mask what has become thin.
    pub(super) fn renew_mask(&mut self) {
        let dense = self.dense_nodes(self.grid.alpha_min);
        self.mask = dense.and(&self.mask);
    }

    /// Goes over to another grid over the same box, for a fresh optimiser, and lowers the density's shift.
    pub(super) fn rescale(&mut self, nodes: UVec3, voxel_m: f64, shift_by: f32) {
        let old = self.shape;
        let new = Shape::new(nodes, (old.low, old.high));
        let (density, _) = self.density.as_chunks::<1>();
        self.density = resample(&old, density, &new).into_flattened();
        self.colors = resample(&old, &self.colors, &new);
        let mask = self.mask.resampled(&old, &new);
        (self.shape, self.voxel_m) = (new, voxel_m);
        self.mask = self.dense_nodes(self.grid.alpha_min).and(&mask);
        self.density_shares.clear();
        self.age = 0;
        self.activation.act_shift -= shift_by;
    }

    /// Rates of the next step.
    pub(crate) fn rates(&self) -> DecayedRates {
        let decay = 0.1f64.powf(self.age as f64 / self.recipe.decay_steps);
        DecayedRates {
            density: self.recipe.density_rate * decay,
            color: self.recipe.color_rate * decay,
            mlp: self.recipe.mlp_rate * decay,
        }
    }
}
