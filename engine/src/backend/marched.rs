//! What marching returns.

use crate::field::RaySample;
use crate::{Error, Result};

/// One ray's samples composited.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RaySummary {
    /// Optical depth: sum of `sigma * dt`.
    pub tau: f32,
    /// Sum of the samples' weights, `transmittance * (1 - exp(-sigma * dt))`.
    pub accumulation: f32,
    /// Sum of `weight * t` in metres: the expected distance times the accumulation.
    pub weighted_distance_m: f32,
    pub sample_count: u32,
}

impl RaySummary {
    /// Composites the samples of one ray, near to far.
    pub fn composite(samples: &[RaySample]) -> Self {
        let mut summary = Self::default();
        for sample in samples {
            let optical = sample.sigma * sample.dt;
            let weight = (-summary.tau).exp() * -(-optical).exp_m1();
            summary.tau += optical;
            summary.accumulation += weight;
            summary.weighted_distance_m += weight * sample.t;
            summary.sample_count += 1;
        }
        summary
    }

    /// Expected Euclidean distance in metres given that the ray hits something; `None` if it hits nothing.
    pub fn expected_distance_m(&self) -> Option<f32> {
        (self.accumulation > 0.0).then(|| self.weighted_distance_m / self.accumulation)
    }
}

/// The summaries of a batch of rays and their samples, ray after ray.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Marched {
    summaries: Vec<RaySummary>,
    samples: Vec<RaySample>,
    /// First sample of every ray.
    starts: Vec<usize>,
}

impl Marched {
    pub(super) fn with_capacity(rays: usize) -> Self {
        Self {
            summaries: Vec::with_capacity(rays),
            samples: Vec::new(),
            starts: Vec::with_capacity(rays),
        }
    }

    /// Appends one ray. `samples` may hold more than the ray's count; the rest is ignored.
    pub(super) fn push(
        &mut self,
        summary: RaySummary,
        samples: &[RaySample],
        samples_per_ray: u32,
    ) -> Result<()> {
        if summary.sample_count > samples_per_ray {
            let (ray, count) = (self.summaries.len(), summary.sample_count);
            return Err(Error::invalid(format!(
                "ray {ray} takes {count} samples, more than the {samples_per_ray} allowed"
            )));
        }
        self.starts.push(self.samples.len());
        self.samples
            .extend_from_slice(&samples[..summary.sample_count as usize]);
        self.summaries.push(summary);
        Ok(())
    }

    /// One summary a ray.
    pub fn summaries(&self) -> &[RaySummary] {
        &self.summaries
    }

    /// The recorded samples of one ray, near to far.
    pub fn samples(&self, ray: usize) -> &[RaySample] {
        let start = self.starts[ray];
        &self.samples[start..start + self.summaries[ray].sample_count as usize]
    }
}
