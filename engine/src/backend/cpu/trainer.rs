//! One training step on the CPU.

use rayon::prelude::*;

use super::adam::{Adam, SkyOptimizer};
use super::chunk::{Chunk, Setting};
use super::colorist::Colorist;
use super::scatter::LevelOptimizer;
use super::simd::Simd;
use super::variation::Smoother;
use super::view_corrections::{ViewCorrection, ViewOptimizer};
use crate::field::Field;
use crate::train::ray::{Rates, RayLosses, StepSums, TrainRay};

/// Rays handled together by one thread: their samples and activations fit the second-level cache.
const RAYS_PER_CHUNK: usize = 64;

/// A field with its optimiser state and all buffers of a step.
#[derive(Debug)]
pub struct CpuTrainer {
    field: Field,
    colorist: Colorist,
    levels: Vec<LevelOptimizer>,
    mlp: Adam,
    sky: SkyOptimizer,
    views: ViewOptimizer,
    smoother: Smoother,
    mlp_gradients: Vec<f32>,
    chunks: Vec<Chunk>,
    sums: StepSums,
    simd: Simd,
}

impl CpuTrainer {
    /// A trainer in f32 on a path of instructions.
    pub fn new(field: Field, simd: Simd) -> Self {
        let colorist = Colorist::exact(&field.mlp, simd);
        Self::with(field, colorist, simd)
    }

    /// The fastest trainer on this machine: its colour network is rounded to bfloat16 where that is an instruction.
    pub fn fastest(field: Field) -> Self {
        let colorist = Colorist::fastest(&field.mlp);
        Self::with(field, colorist, Simd::detect())
    }

    fn with(field: Field, colorist: Colorist, simd: Simd) -> Self {
        Self {
            colorist,
            levels: vec![LevelOptimizer::default(); field.levels.len()],
            mlp: Adam::default(),
            sky: SkyOptimizer::default(),
            views: ViewOptimizer::default(),
            smoother: Smoother::default(),
            mlp_gradients: Vec::new(),
            chunks: Vec::new(),
            sums: StepSums::default(),
            field,
            simd,
        }
    }

    pub fn field(&self) -> &Field {
        &self.field
    }

    pub fn into_field(self) -> Field {
        self.field
    }

    /// Corrections of the views by number, for those that had a ray while their rates were not 0.
    pub fn view_corrections(&self) -> &[ViewCorrection] {
        self.views.views()
    }

    /// Changes the occupancy or adds bricks between steps. Removing bricks is [`Self::retain_bricks`].
    pub fn field_mut(&mut self) -> &mut Field {
        &mut self.field
    }

    /// Drops the bricks of a level for which `keep` does not hold, with their optimiser state.
    pub fn retain_bricks(&mut self, level: usize, keep: impl Fn(u32) -> bool) {
        self.levels[level].resize(self.field.levels[level].brick_count());
        let old_of_new = self.field.levels[level].retain(keep);
        self.levels[level].retain(&old_of_new);
    }

    /// Takes one optimiser step on `rays` and returns its sums.
    pub fn step(&mut self, rays: &[TrainRay], losses: &RayLosses, rates: Rates) -> &StepSums {
        let count = rays.len().div_ceil(RAYS_PER_CHUNK);
        self.chunks.resize_with(count, Chunk::default);
        self.views.prepare(rays, rates);
        let setting = Setting {
            field: &self.field,
            colorist: &self.colorist,
            losses,
            corrections: self.views.corrections(),
            simd: self.simd,
        };
        let chunks = &mut self.chunks;
        chunks
            .par_iter_mut()
            .zip(rays.par_chunks(RAYS_PER_CHUNK))
            .for_each(|(chunk, rays)| chunk.run(setting, rays));
        self.sums.clear();
        self.chunks
            .iter()
            .for_each(|chunk| self.sums.add(&chunk.sums));
        if self.sums.loss.is_finite() {
            self.apply(losses, rates);
        }
        &self.sums
    }

    fn apply(&mut self, losses: &RayLosses, rates: Rates) {
        for (number, (level, optimizer)) in self
            .field
            .levels
            .iter_mut()
            .zip(&mut self.levels)
            .enumerate()
        {
            optimizer.step(level, number, &self.chunks, rates, self.simd);
        }
        if losses.density_variation > 0.0 || losses.feature_variation > 0.0 {
            self.smooth(losses, rates);
        }
        self.views.step(&self.chunks, losses, rates);
        self.mlp_gradients.clear();
        self.mlp_gradients
            .resize(self.field.mlp.parameters().len(), 0.0);
        for chunk in &self.chunks {
            let sums = self.mlp_gradients.iter_mut();
            sums.zip(&chunk.batch.parameter_gradients)
                .for_each(|(s, g)| *s += g);
        }
        self.mlp.step(
            self.field.mlp.parameters_mut(),
            &self.mlp_gradients,
            rates.mlp,
        );
        self.colorist.update(&self.field.mlp);
        if let Some(sky) = &mut self.field.sky {
            self.sky.step(sky, &self.chunks, rates.sky);
        }
    }

    /// Takes the variation's step on every brick that the chunks touched.
    fn smooth(&mut self, losses: &RayLosses, rates: Rates) {
        for (number, level) in self.field.levels.iter_mut().enumerate() {
            let touched = self.chunks.iter().flat_map(|chunk| &chunk.touched[number]);
            self.smoother.smooth(
                level,
                touched.map(|(brick, _)| *brick),
                rates.density * losses.density_variation,
                rates.features * losses.feature_variation,
            );
        }
    }
}
