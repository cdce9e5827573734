//! The stages of a step on the device, for comparing them with the CPU's.

use std::time::Duration;

use backlot_shaders::{INPUT_BLOCKS, VIEW_SUMS, VIEW_VALUES, layout};

use super::GpuTrainer;
use super::rays::step_params;
use crate::backend::cpu::ViewCorrection;
use crate::backend::gpu::network::{unpack, weight_blocks};
use crate::backend::gpu::pace::Pace;
use crate::backend::stages::{StageColor, StageSample, Stages};
use crate::field::{BRICK_NODES, FEATURES, RaySample};
use crate::train::ray::{Rates, RayLosses, TrainRay};

type Result<T> = std::result::Result<T, super::Error>;

impl GpuTrainer {
    /// Trains in batches of this many rays, however long they take.
    pub(in crate::backend::gpu) fn batches_of(&mut self, rays: usize) {
        self.pace = Pace::new(Duration::MAX, rays, rays);
    }

    /// Buffers that hold the densities, and those of every quad of features.
    pub(in crate::backend::gpu) fn part_counts(&self) -> [usize; 2] {
        let (lattices, _, bindings) = self.resident();
        [lattices.shape.density.parts().len(), bindings.parts.len()]
    }

    /// Computes all gradients of one batch of rays and records every stage. Moves nothing. Views are corrected if there are corrections.
    pub(in crate::backend::gpu) fn stages(
        &mut self,
        rays: &[TrainRay],
        losses: &RayLosses,
        corrections: &[ViewCorrection],
    ) -> Result<Stages> {
        if !corrections.is_empty() {
            self.views.set(&self.device, corrections)?;
            self.bindings = None;
        }
        self.upload(rays.len(), &|| false)?;
        let params = layout::TrainParams {
            ray_count: rays.len() as u32,
            step_ray_count: rays.len() as u32,
            view_count: corrections.len() as u32,
            ..step_params(&self.field, losses, Rates::default(), 0)
        };
        let fits = self.resident().1.capacity.rays as usize;
        assert!(rays.len() <= fits, "one batch is recorded, {fits} rays");
        self.submit_forward(rays, params)?;
        let slots = self.colored()?;
        let inputs = &self.resident().1.network.slot_inputs;
        let inputs = inputs.read(&self.device, INPUT_BLOCKS * slots)?;
        let features: Vec<[f32; FEATURES]> = inputs
            .as_chunks::<INPUT_BLOCKS>()
            .0
            .iter()
            .map(|quads| std::array::from_fn(|f| quads[f / 4][f % 4]))
            .collect();
        let learns_poses = layout::TrainParams {
            pose_rate: 1.0,
            ..params
        };
        self.submit_backward(learns_poses)?;
        let mut stages = Stages {
            rays: self.ray_stages(rays.len(), &features)?,
            network: self.network_gradient()?,
            sky: self
                .sky
                .gradients
                .read(&self.device, 3 * params.sky_texel_count as usize)?,
            views: self.view_gradients(corrections.len())?,
            ..Stages::default()
        };
        self.read_level_gradients(&mut stages)?;
        self.update(params, &|| false)
            .expect("nobody cancels, and the device works");
        let sums = self.sums()?;
        stages.color_rays = sums.color_rays;
        stages.squared_error = sums.squared_error;
        stages.loss = sums.loss;
        Ok(stages)
    }

    fn view_gradients(&self, views: usize) -> Result<Vec<[f32; VIEW_VALUES]>> {
        let sums = &self.views.on_device().sums;
        let sums = sums.read(&self.device, VIEW_SUMS * views)?;
        let of_view = |sums: &[u32]| std::array::from_fn(|i| f32::from_bits(sums[i]));
        Ok(sums.chunks_exact(VIEW_SUMS).map(of_view).collect())
    }

    fn colored(&self) -> Result<usize> {
        let counters = self.resident().1.counters.read(&self.device, 1)?;
        Ok(counters[0] as usize)
    }

    fn slot_gradients(&self, slots: usize) -> Result<Vec<[f32; FEATURES]>> {
        let quads = self
            .resident()
            .1
            .network
            .slot_gradients
            .read(&self.device, 3 * slots)?;
        Ok(quads.as_flattened().as_chunks().0.to_vec())
    }

    fn ray_stages(
        &self,
        rays: usize,
        features: &[[f32; FEATURES]],
    ) -> Result<Vec<Vec<StageSample>>> {
        let (device, batch) = (&self.device, self.resident().1);
        let capacity = batch.capacity.samples_per_ray as usize;
        let summaries = batch.summaries.read(device, rays)?;
        let samples = batch.samples.read(device, rays * capacity)?;
        let weights = batch.weights.read(device, rays * capacity)?;
        let slots = batch.slots.read(device, rays * capacity)?;
        let first_points = batch.first_points.read(device, rays)?;
        let points = batch.points.read(device, rays * capacity)?;
        let colors = batch.slot_colors.read(device, features.len())?;
        let gradients = self.slot_gradients(features.len())?;
        let stage = |ray: usize, i: usize| {
            let at = ray * capacity + i;
            let layout::RaySample { t, dt, sigma } = samples[at];
            let slot = slots[at] as usize;
            StageSample {
                sample: RaySample { t, dt, sigma },
                weight: weights[at],
                raw: points[first_points[ray] as usize + i].raw,
                colored: (slots[at] != u32::MAX).then(|| StageColor {
                    features: features[slot],
                    color: [colors[slot][0], colors[slot][1], colors[slot][2]],
                    feature_gradient: gradients[slot],
                }),
            }
        };
        let ray_stage = |(ray, summary): (usize, &layout::RaySummary)| {
            let samples = 0..summary.sample_count as usize;
            samples.map(|i| stage(ray, i)).collect()
        };
        Ok(summaries.iter().enumerate().map(ray_stage).collect())
    }

    fn network_gradient(&self) -> Result<Vec<f32>> {
        let layout = self.field.mlp.layout();
        let partial = &self.resident().1.network.weight_gradients;
        let blocks = partial.read(&self.device, partial.len())?;
        let mut sum = vec![[0.0; 16]; weight_blocks(layout)];
        for thread in blocks.chunks_exact(sum.len()) {
            for (sum, own) in sum.as_flattened_mut().iter_mut().zip(thread.as_flattened()) {
                *sum += own;
            }
        }
        let mut gradient = vec![0.0; layout.len()];
        unpack(&sum, layout, &mut gradient);
        Ok(gradient)
    }

    fn read_level_gradients(&self, stages: &mut Stages) -> Result<()> {
        let lattices = self.resident().0;
        let nodes = lattices.nodes();
        let density = lattices.density_gradients.read(&self.device, 0, nodes)?;
        let mut quads = Vec::new();
        for quad in &lattices.feature_gradients {
            quads.push(quad.read(&self.device, 0, nodes)?);
        }
        let mut start = BRICK_NODES;
        for level in &self.field.levels {
            let own = start..start + level.density().len() - BRICK_NODES;
            start = own.end;
            let mut level_density = vec![0.0; BRICK_NODES];
            level_density.extend_from_slice(&density[own.clone()]);
            let mut features = vec![[0.0; FEATURES]; BRICK_NODES];
            features.extend(own.map(|node| std::array::from_fn(|f| quads[f / 4][node][f % 4])));
            stages.density.push(level_density);
            stages.features.push(features);
        }
        Ok(())
    }
}
