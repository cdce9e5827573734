//! A grid being trained: its values, its mask, its optimiser, and one step.

use std::sync::Mutex;

use glam::{DVec3, UVec3};
use rayon::prelude::*;

use super::adam::GridAdam;
use super::chunk::{Chunk, Coloring, RAYS_PER_CHUNK, Scratch, Setting};
use super::grid::Shape;
use super::losses::LossSetting;
use super::march::{Medium, raw_of_alpha};
use super::mask::NodeMask;
use super::pixels::PixelRay;
use super::recipe::{GridRecipe, StepRecipe};
use super::resample::resample;
use crate::backend::cpu::Simd;
use crate::backend::cpu::adam::Adam;
use crate::backend::cpu::colorist::Colorist;
use crate::field::{ColorMlp, DensityActivation};

/// A stage's state. C colour values per node: 3 and a padding of direct colour, or 12 features.
#[derive(Debug)]
pub(super) struct Stage<const C: usize> {
    pub(super) grid: GridRecipe,
    pub(super) recipe: StepRecipe,
    pub(super) shape: Shape,
    pub(super) density: Vec<f32>,
    pub(super) colors: Vec<[f32; C]>,
    pub(super) mask: NodeMask,
    pub(super) activation: DensityActivation,
    pub(super) network: Option<Network>,
    voxel_m: f64,
    adam: GridAdam<C>,
    /// Steps since the optimiser started anew.
    age: u64,
    losses: LossSetting,
    buffers: Buffers<C>,
    simd: Simd,
}

/// The colour network with its optimiser.
#[derive(Debug)]
pub(super) struct Network {
    pub(super) mlp: ColorMlp,
    colorist: Colorist,
    adam: Adam,
    gradients: Vec<f32>,
}

#[derive(Debug, Default)]
struct Buffers<const C: usize> {
    chunks: Vec<Chunk<C>>,
    /// One for each thread.
    scratch: Vec<Mutex<Scratch>>,
}

/// Mean squared error and loss of a step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct StepError {
    pub(super) squared_error: f64,
    pub(super) loss: f64,
}

/// Edge of one of `voxels` equal cubes that fill the box, and the nodes along each edge of the box.
pub(super) fn resolution((low, high): (DVec3, DVec3), voxels: u64) -> (f64, UVec3) {
    let size = high - low;
    let voxel_m = (size.element_product() / voxels as f64).cbrt();
    (voxel_m, (size / voxel_m).as_uvec3().max(UVec3::splat(2)))
}

impl Network {
    pub(super) fn new(mlp: ColorMlp) -> Self {
        Self {
            colorist: Colorist::fastest(&mlp),
            adam: Adam::default(),
            gradients: Vec::new(),
            mlp,
        }
    }

    fn step<const C: usize>(&mut self, chunks: &[Chunk<C>], rate: f32) {
        self.gradients.clear();
        self.gradients.resize(self.mlp.parameters().len(), 0.0);
        for chunk in chunks {
            let sums = self.gradients.iter_mut().zip(&chunk.network_gradients);
            sums.for_each(|(sum, g)| *sum += g);
        }
        self.adam
            .step(self.mlp.parameters_mut(), &self.gradients, rate);
        self.colorist.update(&self.mlp);
    }
}

impl<const C: usize> Stage<C> {
    /// An untouched grid of `nodes` over a box, with voxels of `voxel_m` (which with the box need not fit exactly), in a mask.
    pub(super) fn new(
        (grid, recipe): (GridRecipe, StepRecipe),
        shape: Shape,
        (voxel_m, base_voxel_m): (f64, f64),
        mask: NodeMask,
        network: Option<Network>,
        backdrop: [f32; 3],
    ) -> Self {
        Self {
            density: vec![0.0; shape.len()],
            colors: vec![[0.0; C]; shape.len()],
            mask,
            activation: DensityActivation::from_alpha(grid.alpha_init, base_voxel_m as f32),
            network,
            voxel_m,
            adam: GridAdam::new(&shape, recipe.masked, Vec::new()),
            age: 0,
            losses: LossSetting::new(&recipe, backdrop),
            buffers: Buffers::default(),
            simd: Simd::detect(),
            grid,
            recipe,
            shape,
        }
    }

    /// Scales the density's learning rate at every node.
    pub(super) fn set_density_shares(&mut self, shares: Vec<f32>) {
        self.adam = GridAdam::new(&self.shape, self.recipe.masked, shares);
    }

    pub(super) fn step_m(&self) -> f64 {
        self.grid.step_voxels * self.voxel_m
    }

    /// Length of a voxel in base voxels.
    fn voxel_ratio(&self) -> f64 {
        self.voxel_m / f64::from(self.activation.base_voxel_m)
    }

    pub(super) fn medium(&self) -> Medium<'_> {
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

    /// Goes over to another grid over the same box, with a fresh optimiser, and lowers the density's shift.
    pub(super) fn rescale(&mut self, nodes: UVec3, voxel_m: f64, shift_by: f32) {
        let old = self.shape;
        let new = Shape::new(nodes, (old.low, old.high));
        let (density, _) = self.density.as_chunks::<1>();
        self.density = resample(&old, density, &new).into_flattened();
        self.colors = resample(&old, &self.colors, &new);
        let mask = self.mask.resampled(&old, &new);
        (self.shape, self.voxel_m) = (new, voxel_m);
        self.mask = self.dense_nodes(self.grid.alpha_min).and(&mask);
        self.adam = GridAdam::new(&new, self.recipe.masked, Vec::new());
        if let Some(network) = &mut self.network {
            network.adam = Adam::default();
        }
        self.age = 0;
        self.activation.act_shift -= shift_by;
    }

    /// One optimiser step on `rays`. Does not move anything if the loss is not finite.
    pub(super) fn step(&mut self, rays: &[PixelRay]) -> StepError {
        let mut buffers = std::mem::take(&mut self.buffers);
        self.differentiate(rays, &mut buffers);
        let chunks = &buffers.chunks;
        let error = StepError {
            squared_error: chunks.iter().map(|c| c.squared_error).sum::<f64>() / rays.len() as f64,
            loss: chunks.iter().map(|c| c.loss).sum(),
        };
        if error.loss.is_finite() {
            self.apply(chunks);
        }
        self.buffers = buffers;
        error
    }

    fn differentiate(&self, rays: &[PixelRay], buffers: &mut Buffers<C>) {
        let count = rays.len().div_ceil(RAYS_PER_CHUNK);
        buffers.chunks.resize_with(count, Chunk::default);
        buffers
            .scratch
            .resize_with(rayon::current_num_threads(), Mutex::default);
        let setting = Setting {
            medium: self.medium(),
            colors: &self.colors,
            coloring: match &self.network {
                Some(network) => Coloring::Network(&network.colorist),
                None => Coloring::Direct,
            },
            losses: self.losses,
            weight_min: self.grid.alpha_min as f32,
            simd: self.simd,
        };
        let scratch = &buffers.scratch;
        buffers
            .chunks
            .par_iter_mut()
            .zip(rays.par_chunks(RAYS_PER_CHUNK))
            .with_max_len(1)
            .for_each(|(chunk, rays)| {
                let thread = rayon::current_thread_index().unwrap_or(0);
                let mut scratch = scratch[thread].lock().expect("no thread panicked");
                chunk.run(&setting, rays, &mut scratch);
            });
    }

    fn apply(&mut self, chunks: &[Chunk<C>]) {
        let decay = 0.1f64.powf(self.age as f64 / self.recipe.decay_steps);
        let rates = (
            self.recipe.density_rate * decay,
            self.recipe.color_rate * decay,
        );
        let values = (self.density.as_mut_slice(), self.colors.as_mut_slice());
        self.adam
            .step(&self.shape, values, chunks, rates, self.simd);
        if let Some(network) = &mut self.network {
            network.step(chunks, (self.recipe.mlp_rate * decay) as f32);
        }
        self.age += 1;
    }
}
