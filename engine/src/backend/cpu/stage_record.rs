//! The stages of a step on the CPU, for comparing other backends with.

use super::Simd;
use super::chunk::{Chunk, NO_SLOT};
use super::mirror::{Scene, offsets};
use super::mlp::PADDED_FEATURES;
use crate::backend::stages::{StageColor, StageSample, Stages};
use crate::field::{BRICK_NODES, FEATURES};

impl Scene {
    /// What every stage found on a path of instructions.
    pub(in crate::backend) fn stages(&self, simd: Simd) -> Stages {
        let chunk = self.run(simd);
        let dense = self.dense_gradient(&chunk);
        let single = |range: std::ops::Range<usize>| -> Vec<f32> {
            dense[range].iter().map(|g| *g as f32).collect()
        };
        let at = offsets(&self.field);
        let mut stages = Stages {
            rays: self.ray_stages(&chunk),
            network: single(at.mlp..at.sky),
            sky: single(at.sky..at.views),
            views: single(at.views..dense.len()).as_chunks().0.to_vec(),
            color_rays: chunk.sums.color_rays,
            squared_error: chunk.sums.squared_error,
            loss: chunk.sums.loss,
            ..Stages::default()
        };
        for (density_at, features_at) in &at.levels {
            let nodes = features_at - density_at;
            let mut density = single(*density_at..*features_at);
            let mut features = single(*features_at..features_at + nodes * FEATURES);
            // What falls on missing bricks is lost.
            density[..BRICK_NODES].fill(0.0);
            features[..BRICK_NODES * FEATURES].fill(0.0);
            stages.density.push(density);
            stages.features.push(features.as_chunks().0.to_vec());
        }
        stages
    }

    fn ray_stages(&self, chunk: &Chunk) -> Vec<Vec<StageSample>> {
        let mut points = chunk.points.iter().peekable();
        let mut start = 0;
        let rays = self.corrected_rays();
        let ray_samples = |(ray, end): (&crate::train::ray::TrainRay, &u32)| {
            let samples = (start..*end as usize).map(|i| {
                let sample = chunk.samples[i];
                // Samples without any gradient have no point.
                let own = points.next_if(|point| point.position == ray.ray.at(sample.t));
                StageSample {
                    sample,
                    weight: chunk.weights[i],
                    raw: own.map_or(0.0, |point| point.raw),
                    colored: (chunk.slots[i] != NO_SLOT).then(|| color(chunk, chunk.slots[i])),
                }
            });
            let samples = samples.collect();
            start = *end as usize;
            samples
        };
        rays.iter().zip(&chunk.ray_ends).map(ray_samples).collect()
    }
}

fn color(chunk: &Chunk, slot: u32) -> StageColor {
    let row = slot as usize * PADDED_FEATURES;
    let twelve = |values: &[f32]| std::array::from_fn(|f| values[row + f]);
    StageColor {
        features: twelve(&chunk.batch.features),
        color: chunk.batch.color(slot as usize),
        feature_gradient: twelve(&chunk.batch.feature_gradients),
    }
}
