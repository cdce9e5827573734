//! What each stage of a step on a grid finds, for comparing backends.

use super::{Chunk, Coloring, RAYS_PER_BLOCK, Scratch, Setting};
use crate::backend::cpu::Simd;
use crate::backend::cpu::colorist::Colorist;
use crate::train::dvgo::pixels::PixelRay;
use crate::train::dvgo::stage::Stage;

/// The stages of one step's rays.
#[derive(Clone, Debug)]
pub(crate) struct GridStages<const C: usize> {
    pub(crate) rays: Vec<RayStage<C>>,
    /// Gradients by every node's values.
    pub(crate) density: Vec<f32>,
    pub(crate) colors: Vec<[f32; C]>,
    /// By the colour network's parameters.
    pub(crate) network: Vec<f32>,
    /// Sums over the rays.
    pub(crate) squared_error: f64,
    pub(crate) loss: f64,
}

#[derive(Clone, Debug)]
pub(crate) struct RayStage<const C: usize> {
    /// Near to far.
    pub(crate) samples: Vec<SampleStage<C>>,
    /// Light at its end.
    pub(crate) left: f32,
}

#[derive(Clone, Copy, Debug)]
pub(crate) struct SampleStage<const C: usize> {
    /// Node coordinates.
    pub(crate) q: [f32; 3],
    pub(crate) tau: f32,
    pub(crate) slope: f32,
    pub(crate) weight: f32,
    /// Gradient by the raw density.
    pub(crate) raw: f32,
    /// Of a sample that is coloured: its colour, and the gradient by its colour values.
    pub(crate) shown: Option<([f32; 3], [f32; C])>,
}

impl<const C: usize> GridStages<C> {
    /// Nothing yet, for a stage.
    pub(crate) fn new(stage: &Stage<C>) -> Self {
        Self {
            rays: Vec::new(),
            density: vec![0.0; stage.shape.len()],
            colors: vec![[0.0; C]; stage.shape.len()],
            network: vec![0.0; stage.mlp.as_ref().map_or(0, |mlp| mlp.parameters().len())],
            squared_error: 0.0,
            loss: 0.0,
        }
    }

    /// All gradients of `rays` on a path of instructions, in f32.
    pub(crate) fn on_cpu(stage: &Stage<C>, rays: &[PixelRay], simd: Simd) -> Self {
        let colorist = stage.mlp.as_ref().map(|mlp| Colorist::exact(mlp, simd));
        let setting = Setting {
            medium: stage.medium(),
            colors: &stage.colors,
            coloring: colorist
                .as_ref()
                .map_or(Coloring::Direct, Coloring::Network),
            losses: stage.losses,
            weight_min: stage.grid.alpha_min as f32,
            simd,
        };
        let mut stages = Self::new(stage);
        for rays in rays.chunks(RAYS_PER_BLOCK) {
            let (mut chunk, mut scratch) = (Chunk::default(), Scratch::default());
            chunk.run(&setting, rays, &mut scratch);
            stages.add(stage, &chunk, &scratch);
        }
        stages
    }

    /// What one block found.
    fn add(&mut self, stage: &Stage<C>, chunk: &Chunk<C>, scratch: &Scratch) {
        let (mut start, mut slot) = (0, 0);
        for (ray, end) in scratch.ray_ends.iter().enumerate() {
            let sample = |i: usize| {
                let sample = scratch.samples[i];
                let shown = scratch.shown[i].then(|| {
                    let row = &scratch.batch.colors[4 * slot..];
                    let color = [row[0], row[1], row[2]];
                    let of_sample = (color, chunk.color_gradients[slot]);
                    slot += 1;
                    of_sample
                });
                SampleStage {
                    q: sample.q.to_array(),
                    tau: sample.tau,
                    slope: sample.slope,
                    weight: scratch.weights[i],
                    raw: scratch.tau_gradients[i] * sample.slope,
                    shown,
                }
            };
            self.rays.push(RayStage {
                samples: (start..*end as usize).map(sample).collect(),
                left: scratch.light_left[ray],
            });
            start = *end as usize;
        }
        for point in &chunk.points {
            let cell = stage.shape.cell(point.q);
            for (node, weight) in cell.corners().into_iter().zip(cell.weights()) {
                self.density[node as usize] += weight * point.raw;
                if let Some(gradient) = chunk.color_gradients.get(point.slot as usize) {
                    let sums = self.colors[node as usize].iter_mut().zip(gradient);
                    sums.for_each(|(sum, g)| *sum += weight * g);
                }
            }
        }
        let sums = self.network.iter_mut().zip(&chunk.network_gradients);
        sums.for_each(|(sum, g)| *sum += g);
        self.squared_error += chunk.squared_error;
        self.loss += chunk.loss;
    }
}
