//! Marching batches of rays on the CPU's threads.

use std::sync::Arc;

use rayon::prelude::*;

use crate::backend::{LoadedField, MarchRay, Marched, RaySummary};
use crate::field::{Field, Lattice, RaySample};
use crate::{Error, Result};

/// Rays between two looks at the cancellation: some milliseconds of marching.
const RAYS_PER_PIECE: usize = 4096;
/// Rays one thread takes at a time: enough to reuse its sample buffer, few enough to balance.
const RAYS_PER_TASK: usize = 128;

#[derive(Debug)]
pub(super) struct CpuField {
    field: Arc<Field>,
}

impl CpuField {
    pub(super) fn new(field: Arc<Field>) -> Self {
        Self { field }
    }
}

impl LoadedField for CpuField {
    fn resident_bytes(&self) -> u64 {
        let bytes = |level: &Lattice| {
            size_of_val(level.density())
                + size_of_val(level.features())
                + size_of_val(level.index())
        };
        self.field
            .levels()
            .iter()
            .map(|level| bytes(level) as u64)
            .sum()
    }

    fn march(
        &self,
        rays: &[MarchRay],
        samples_per_ray: u32,
        cancelled: &dyn Fn() -> bool,
    ) -> Result<Marched> {
        let mut marched = Marched::with_capacity(rays.len());
        for piece in rays.chunks(RAYS_PER_PIECE) {
            if cancelled() {
                return Err(Error::Cancelled);
            }
            let tasks: Vec<(Vec<u32>, Vec<RaySample>)> = piece
                .par_chunks(RAYS_PER_TASK)
                .map(|task| march_task(&self.field, task))
                .collect();
            for (counts, samples) in tasks {
                let mut rest = &samples[..];
                for count in counts {
                    let (own, others) = rest.split_at(count as usize);
                    marched.push(RaySummary::composite(own), own, samples_per_ray)?;
                    rest = others;
                }
            }
        }
        Ok(marched)
    }
}

/// Sample counts of the rays, and their samples one ray after the other.
fn march_task(field: &Field, rays: &[MarchRay]) -> (Vec<u32>, Vec<RaySample>) {
    let mut samples = Vec::new();
    let mut counts = Vec::with_capacity(rays.len());
    for MarchRay { ray, range } in rays {
        let before = samples.len();
        field.march_ray(*ray, *range, &mut samples);
        counts.push((samples.len() - before) as u32);
    }
    (counts, samples)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::backend::test_scene::{SAMPLES_PER_RAY, field, march_cpu, rays};

    #[test]
    fn a_batch_is_every_ray_marched_alone() {
        let field = Arc::new(field());
        // More than one piece, and not a whole number of tasks.
        let rays: Vec<MarchRay> = rays()
            .into_iter()
            .cycle()
            .take(RAYS_PER_PIECE + RAYS_PER_TASK + 1)
            .collect();
        let marched = march_cpu(&field, &rays);
        assert_eq!(marched.summaries().len(), rays.len());
        let mut alone = Vec::new();
        for (index, MarchRay { ray, range }) in rays.iter().enumerate() {
            alone.clear();
            let tau = field.march_ray(*ray, *range, &mut alone);
            assert_eq!(marched.samples(index), alone, "ray {index}");
            assert_eq!(marched.summaries()[index].tau, tau, "ray {index}");
        }
    }

    #[test]
    fn limits_and_cancellation_are_heeded() {
        let field = CpuField::new(Arc::new(field()));
        let rays = rays();
        assert!(matches!(
            field.march(&rays, 3, &|| false),
            Err(Error::Invalid { .. })
        ));
        assert!(matches!(
            field.march(&rays, SAMPLES_PER_RAY, &|| true),
            Err(Error::Cancelled)
        ));
        assert!(field.resident_bytes() > 0);
    }
}
