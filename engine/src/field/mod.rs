//! The radiance field: density and colour of space, and the sky beyond it.
//!
//! A [`Field`] is a sum of brick-sparse [`Lattice`] levels with falling voxel sizes. Raw density and 12 colour features at a
//! point are the sums of the levels' trilinear interpolations; `sigma = softplus(raw + shift) / base_voxel_m` in 1/m and
//! `rgb = sigmoid(MLP(features, view))` in sRGB. One fully allocated level is the dense grid of DVGO. An [`Occupancy`] mask says
//! where rays must sample, and a [`SkyMap`] colours what the box does not hold.

pub mod activation;
pub mod lattice;
pub mod march;
pub mod mlp;
pub mod occupancy;
pub(crate) mod probe;
pub mod sky;
pub mod transcendental;
pub mod view_encoding;

pub use activation::DensityActivation;
pub use lattice::{BRICK_NODES, BRICK_SIDE, FEATURES, Lattice, NULL_BRICK};
pub use march::{MarchRange, Ray, RaySample};
pub use mlp::ColorMlp;
pub use occupancy::Occupancy;
pub use sky::{SkyGrid, SkyMap};
pub use view_encoding::encode_view;

use glam::Vec3;

use crate::backend::cpu::Simd;
use crate::backend::cpu::mlp::MlpBatch;

/// A trained or training radiance field in its local metric frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Field {
    /// Lower and upper corner of the box outside of which nothing is.
    pub(crate) bounds_m: (Vec3, Vec3),
    /// Coarse to fine.
    pub(crate) levels: Vec<Lattice>,
    pub(crate) activation: DensityActivation,
    pub(crate) mlp: ColorMlp,
    /// Absent for objects.
    pub(crate) sky: Option<SkyMap>,
    pub(crate) occupancy: Occupancy,
    /// Metres of step per metre of distance: pixels widen, so far steps may.
    pub(crate) step_growth: f32,
}

/// Buffers reused between calls of [`Field::colors`].
#[derive(Clone, Debug, Default)]
pub struct ColorScratch {
    batch: MlpBatch,
}

impl Field {
    /// Lower and upper corner of the box.
    pub fn bounds(&self) -> (Vec3, Vec3) {
        self.bounds_m
    }

    /// Bytes of the arrays held in memory.
    pub fn memory_bytes(&self) -> u64 {
        let levels = self.levels.iter().map(|level| {
            size_of_val(level.density())
                + size_of_val(level.features())
                + size_of_val(level.positions())
                + size_of_val(level.index())
        });
        let occupancy = size_of_val(self.occupancy.masks()) + size_of_val(self.occupancy.index());
        let grids = self.sky.iter().flat_map(|sky| sky.grids());
        let sky: usize = grids.map(|grid| size_of_val(grid.logits())).sum();
        (levels.sum::<usize>() + occupancy + sky) as u64
    }

    pub fn finest_voxel_m(&self) -> f32 {
        self.levels.last().map_or(0.0, Lattice::voxel_m)
    }

    /// Coarse to fine.
    pub fn levels(&self) -> &[Lattice] {
        &self.levels
    }

    pub fn activation(&self) -> DensityActivation {
        self.activation
    }

    pub fn occupancy(&self) -> &Occupancy {
        &self.occupancy
    }

    pub fn mlp(&self) -> &ColorMlp {
        &self.mlp
    }

    /// Sum of the levels' interpolated raw densities.
    #[inline]
    pub fn raw_density(&self, p: Vec3) -> f32 {
        self.levels.iter().map(|level| level.raw_density(p)).sum()
    }

    /// Density in 1/m, 0 outside the box and where no level stores anything.
    #[inline]
    pub fn sigma(&self, p: Vec3) -> f32 {
        let mut raw = 0.0;
        let mut stored = false;
        for level in &self.levels {
            if let Some(corners) = level.corners(p) {
                stored = true;
                for (node, weight) in corners.nodes.iter().zip(corners.weights) {
                    raw += level.density()[*node as usize] * weight;
                }
            }
        }
        if stored {
            self.activation.sigma(raw)
        } else {
            0.0
        }
    }

    /// Sum of the levels' interpolated features.
    #[inline]
    pub fn features(&self, p: Vec3) -> [f32; FEATURES] {
        let mut features = [0.0; FEATURES];
        for level in &self.levels {
            level.add_features(p, &mut features);
        }
        features
    }

    /// Appends the samples of a ray between `t_min` and `t_max` to `out`, near to far, skipping empty space.
    ///
    /// `direction` is a unit vector, so distances are metres. Ends once the field's own optical depth exceeds `stop_tau`.
    /// Returns the optical depth reached.
    pub fn march(
        &self,
        origin: Vec3,
        direction: Vec3,
        t_min: f32,
        t_max: f32,
        stop_tau: f32,
        out: &mut Vec<RaySample>,
    ) -> f32 {
        let range = MarchRange {
            t_min,
            t_max,
            stop_tau,
            phase: 0.5,
        };
        self.march_ray(Ray { origin, direction }, range, out)
    }

    /// [`Self::march`] with a free sampling phase.
    pub fn march_ray(&self, ray: Ray, range: MarchRange, out: &mut Vec<RaySample>) -> f32 {
        let mut tau = 0.0;
        march::march(Simd::detect(), self, ray, range, out, &mut tau);
        tau
    }

    /// Replaces `out` by the sRGB colours at `positions` seen along `directions` (unit vectors), same lengths.
    ///
    /// Runs of equal directions, as the samples of one ray have, are encoded once.
    pub fn colors(
        &self,
        positions: &[Vec3],
        directions: &[Vec3],
        out: &mut Vec<[f32; 3]>,
        scratch: &mut ColorScratch,
    ) {
        assert_eq!(
            positions.len(),
            directions.len(),
            "one direction per position"
        );
        let batch = &mut scratch.batch;
        batch.clear();
        probe::gather_features(Simd::detect(), self, positions, &mut batch.features);
        for (number, direction) in directions.iter().enumerate() {
            if directions.get(number + 1) != Some(direction) {
                batch.views.extend_from_slice(&encode_view(*direction));
                batch.ray_ends.push(number as u32 + 1);
            }
        }
        batch.forward(&self.mlp, Simd::detect());
        out.clear();
        out.extend((0..positions.len()).map(|sample| batch.color(sample)));
    }

    /// sRGB at infinity; black for an object, which has no sky.
    pub fn sky(&self, direction: Vec3) -> [f32; 3] {
        self.sky
            .as_ref()
            .map_or([0.0; 3], |sky| sky.color(direction))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Draws;

    #[test]
    fn batched_colors_equal_the_plain_network_on_every_path() {
        let mut draws = Draws::new(3, 0, 0);
        for width in ColorMlp::WIDTHS {
            let mlp = ColorMlp::new(width, || draws.unit());
            let mut batch = MlpBatch::default();
            let mut expected = Vec::new();
            for (ray, samples) in [3u32, 1, 9].into_iter().enumerate() {
                let direction = Vec3::new(ray as f32, 1.0, -0.3).normalize_or_zero();
                let view = encode_view(direction);
                for _ in 0..samples {
                    let features = std::array::from_fn(|_| draws.uniform(-2.0, 2.0) as f32);
                    batch.features.extend_from_slice(&features);
                    batch.features.extend_from_slice(&[0.0; 4]);
                    expected.push(mlp.forward(&features, &view));
                }
                batch.views.extend_from_slice(&view);
                batch.ray_ends.push(expected.len() as u32);
            }
            for simd in Simd::available() {
                batch.forward(&mlp, simd);
                for (sample, expected) in expected.iter().enumerate() {
                    let color = batch.color(sample);
                    for c in 0..3 {
                        // 128 terms a layer at 6e-8 relative rounding each, and two paths.
                        assert!((color[c] - expected[c]).abs() < 2e-5, "{simd:?} {width}");
                    }
                }
            }
        }
    }
}
