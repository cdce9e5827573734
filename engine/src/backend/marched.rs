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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_sum_to_what_the_optical_depth_hides() {
        let sample = |t: f32, sigma: f32| RaySample { t, dt: 0.5, sigma };
        let samples = [
            sample(1.0, 0.2),
            sample(1.5, 0.0),
            sample(2.0, 3.0),
            sample(2.5, 40.0),
        ];
        let summary = RaySummary::composite(&samples);
        assert!(
            (summary.accumulation - (1.0 - (-summary.tau).exp())).abs() < 1e-6,
            "{summary:?}"
        );
        let expected = summary.expected_distance_m().unwrap();
        assert!((1.0..2.5).contains(&expected), "{expected}");
        assert_eq!(RaySummary::composite(&[]).expected_distance_m(), None);
    }

    #[test]
    fn a_wall_is_seen_at_its_distance() {
        let wall = RaySample {
            t: 7.0,
            dt: 0.1,
            sigma: 1e4,
        };
        let summary = RaySummary::composite(&[
            RaySample {
                t: 3.0,
                dt: 0.1,
                sigma: 0.0,
            },
            wall,
        ]);
        assert_eq!(
            (summary.accumulation, summary.expected_distance_m()),
            (1.0, Some(7.0))
        );
    }

    #[test]
    fn more_samples_than_allowed_are_refused() {
        let mut marched = Marched::with_capacity(1);
        let samples = [RaySample::default(); 3];
        assert!(
            marched
                .push(RaySummary::composite(&samples), &samples, 2)
                .is_err()
        );
        assert!(
            marched
                .push(RaySummary::composite(&samples), &samples, 3)
                .is_ok()
        );
        assert_eq!(marched.samples(0), samples);
    }
}
