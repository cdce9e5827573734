//! The stages of a step on the device, for comparing them with the CPU's.

use std::time::Duration;

use super::GpuGrid;
use super::params::{StepRates, batch_params, train_params};
use crate::backend::gpu::error::Error;
use crate::backend::gpu::network::{unpack, weight_blocks};
use crate::backend::gpu::pace::Pace;
use crate::train::dvgo::record::{GridStages, RayStage, SampleStage};
use crate::train::dvgo::{PixelRay, Stage};

impl GpuGrid {
    /// Trains in batches of this many rays, however long they take.
    pub(in crate::backend::gpu) fn batches_of(&mut self, rays: usize) {
        self.pace = Pace::new(Duration::MAX, rays, rays);
    }

    /// Takes the stage's next step on one batch of rays and records what it finds.
    pub(in crate::backend::gpu) fn stages<const C: usize>(
        &mut self,
        stage: &Stage<C>,
        rays: &[PixelRay],
    ) -> Result<GridStages<C>, Error> {
        let fits = self.batch.capacity.rays as usize;
        assert!(rays.len() <= fits, "one batch is recorded, {fits} rays");
        let rates = StepRates::of(stage);
        let mut params = batch_params(stage, rates, self.batch.capacity.samples_per_ray);
        params.ray_count = rays.len() as u32;
        params.has_shares = u32::from(self.nodes.has_shares);
        self.submit_forward(rays, params, train_params(rates, rays.len()))?;
        self.submit_backward(params)?;
        let mut stages = GridStages::new(stage);
        stages.rays = self.ray_stages(rays.len())?;
        self.node_gradients(&mut stages)?;
        if let Some(mlp) = &stage.mlp {
            self.network_gradient(mlp.layout(), &mut stages.network)?;
        }
        self.update(params, &|| false)
            .expect("nobody cancels, and the device works");
        let sums = self.sums()?;
        (stages.squared_error, stages.loss) = (sums.squared_error, sums.loss);
        Ok(stages)
    }

    fn ray_stages<const C: usize>(&self, rays: usize) -> Result<Vec<RayStage<C>>, Error> {
        let (device, batch) = (&self.device, &self.batch);
        let capacity = batch.capacity.samples_per_ray as usize;
        let lights = batch.lights.read(device, rays)?;
        let samples = batch.samples.read(device, rays * capacity)?;
        let points = batch.points.read(device, rays * capacity)?;
        let slots = batch.counters.read(device, 1)?[0] as usize;
        let colors = batch.slot_colors.read(device, slots)?;
        let gradients = match &batch.network {
            Some(network) => network.slot_gradients.read(device, C / 4 * slots)?,
            None => batch.slot_color_gradients.read(device, slots)?,
        };
        let gradients = gradients.as_flattened().as_chunks::<C>().0;
        let ray_stage = |(ray, light): (usize, &backlot_shaders::grid_layout::RayLight)| {
            let own = 0..light.sample_count as usize;
            let of_sample = |i: usize| {
                let sample = samples[ray * capacity + i];
                let point = points[light.first_point as usize + i];
                assert_eq!((point.q, point.slot), (sample.q, sample.slot));
                let slot = sample.slot as usize;
                let [r, g, b, _] = colors.get(slot).copied().unwrap_or_default();
                SampleStage {
                    q: sample.q,
                    tau: sample.tau,
                    slope: sample.slope,
                    weight: sample.weight,
                    raw: point.raw,
                    shown: (sample.slot != u32::MAX).then(|| ([r, g, b], gradients[slot])),
                }
            };
            RayStage {
                samples: own.map(of_sample).collect(),
                left: light.left,
            }
        };
        Ok(lights.iter().enumerate().map(ray_stage).collect())
    }

    fn node_gradients<const C: usize>(&self, stages: &mut GridStages<C>) -> Result<(), Error> {
        let (nodes, device) = (stages.density.len(), &self.device);
        stages.density = self.nodes.density.gradients.read(device, nodes)?;
        for (number, quad) in self.nodes.quads.iter().enumerate() {
            let quads = quad.gradients.read(device, nodes)?;
            for (node, quad) in stages.colors.iter_mut().zip(&quads) {
                node.as_chunks_mut::<4>().0[number] = *quad;
            }
        }
        Ok(())
    }

    fn network_gradient(
        &self,
        layout: crate::field::mlp::MlpLayout,
        out: &mut [f32],
    ) -> Result<(), Error> {
        let Some(network) = &self.batch.network else {
            return Ok(());
        };
        let partial = &network.weight_gradients;
        let blocks = partial.read(&self.device, partial.len())?;
        let mut sum = vec![[0.0; 16]; weight_blocks(layout)];
        for share in blocks.chunks_exact(sum.len()) {
            for (sum, own) in sum.as_flattened_mut().iter_mut().zip(share.as_flattened()) {
                *sum += own;
            }
        }
        unpack(&sum, layout, out);
        Ok(())
    }
}
