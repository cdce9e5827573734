//! Steps of a stage on the processor.

use std::sync::Mutex;

use rayon::prelude::*;

use super::adam::GridAdam;
use super::chunk::{Chunk, Coloring, RAYS_PER_CHUNK, Scratch, Setting};
use super::pixels::PixelRay;
use super::stage::Stage;
use super::steps::StepError;
use crate::backend::GridArithmetic;
use crate::backend::cpu::Simd;
use crate::backend::cpu::adam::Adam;
use crate::backend::cpu::colorist::Colorist;
use crate::field::ColorMlp;

/// A stage's optimiser and the buffers of a step.
#[derive(Debug)]
pub(super) struct CpuSteps<const C: usize> {
    adam: GridAdam<C>,
    network: Option<NetworkSteps>,
    buffers: Buffers<C>,
    simd: Simd,
}

/// The colour network's kernels and optimiser.
#[derive(Debug)]
struct NetworkSteps {
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

impl NetworkSteps {
    fn new(mlp: &ColorMlp, arithmetic: GridArithmetic) -> Self {
        Self {
            colorist: match arithmetic {
                GridArithmetic::Fastest => Colorist::fastest(mlp),
                GridArithmetic::InF32(simd) => Colorist::exact(mlp, simd),
            },
            adam: Adam::default(),
            gradients: Vec::new(),
        }
    }

    fn step<const C: usize>(&mut self, mlp: &mut ColorMlp, chunks: &[Chunk<C>], rate: f32) {
        self.gradients.clear();
        self.gradients.resize(mlp.parameters().len(), 0.0);
        for chunk in chunks {
            let sums = self.gradients.iter_mut().zip(&chunk.network_gradients);
            sums.for_each(|(sum, g)| *sum += g);
        }
        self.adam.step(mlp.parameters_mut(), &self.gradients, rate);
        self.colorist.update(mlp);
    }
}

impl<const C: usize> CpuSteps<C> {
    /// A fresh optimiser for a stage.
    pub(super) fn new(stage: &Stage<C>, arithmetic: GridArithmetic) -> Self {
        let shares = stage.density_shares.clone();
        let network = stage.mlp.as_ref();
        Self {
            adam: GridAdam::new(&stage.shape, stage.recipe.masked, shares),
            network: network.map(|mlp| NetworkSteps::new(mlp, arithmetic)),
            buffers: Buffers::default(),
            simd: match arithmetic {
                GridArithmetic::Fastest => Simd::detect(),
                GridArithmetic::InF32(simd) => simd,
            },
        }
    }

    /// One optimiser step on `rays`. Does not move anything if the loss is not finite.
    pub(super) fn step(&mut self, stage: &mut Stage<C>, rays: &[PixelRay]) -> StepError {
        let mut buffers = std::mem::take(&mut self.buffers);
        self.differentiate(stage, rays, &mut buffers);
        let chunks = &buffers.chunks;
        let error = StepError {
            squared_error: chunks.iter().map(|c| c.squared_error).sum::<f64>() / rays.len() as f64,
            loss: chunks.iter().map(|c| c.loss).sum(),
        };
        if error.loss.is_finite() {
            self.apply(stage, chunks);
        }
        self.buffers = buffers;
        error
    }

    fn differentiate(&self, stage: &Stage<C>, rays: &[PixelRay], buffers: &mut Buffers<C>) {
        let count = rays.len().div_ceil(RAYS_PER_CHUNK);
        buffers.chunks.resize_with(count, Chunk::default);
        buffers
            .scratch
            .resize_with(rayon::current_num_threads(), Mutex::default);
        let setting = Setting {
            medium: stage.medium(),
            colors: &stage.colors,
            coloring: match &self.network {
                Some(network) => Coloring::Network(&network.colorist),
                None => Coloring::Direct,
            },
            losses: stage.losses,
            weight_min: stage.grid.alpha_min as f32,
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

    fn apply(&mut self, stage: &mut Stage<C>, chunks: &[Chunk<C>]) {
        let rates = stage.rates();
        let values = (stage.density.as_mut_slice(), stage.colors.as_mut_slice());
        let of_grid = (rates.density, rates.color);
        self.adam
            .step(&stage.shape, values, chunks, of_grid, self.simd);
        if let (Some(network), Some(mlp)) = (&mut self.network, &mut stage.mlp) {
            network.step(mlp, chunks, rates.mlp as f32);
        }
        stage.age += 1;
    }
}
