//! Forward and backward of a chunk of rays: march, colour, composite, lose, and turn it all around.

use glam::Vec3;

use super::bf16::Bf16Batch;
use super::colorist::Colorist;
use super::lanes::Lanes;
use super::mlp::MlpBatch;
use super::simd::{Simd, dispatch};
use super::view_corrections::{Corrections, ViewGradient};
use crate::field::march::march_generic;
use crate::field::probe::{GROUP, Places, Positions, gather_features};
use crate::field::{Field, MarchRange, RaySample, encode_view};
use crate::train::ray::{RayLosses, StepSums, TrainRay};
use crate::volume;

/// Optical depth at which a ray ends: transmittance 1e-3, as in DVGO.
const STOP_TAU: f32 = 6.9;
/// A sample without colour.
pub(crate) const NO_SLOT: u32 = u32::MAX;
/// Points of a chunk are numbered in 16 bits where gradients are sorted.
const MAX_POINTS: usize = 1 << 16;

/// The gradient at one point in space.
#[derive(Clone, Copy, Debug)]
pub(super) struct PointGradient {
    pub(super) position: Vec3,
    /// By the raw density.
    pub(super) raw: f32,
    /// Row of the feature gradients, or [`NO_SLOT`].
    pub(super) slot: u32,
}

/// A sky texel's gradient: grid in the top byte, texel below.
#[derive(Clone, Copy, Debug)]
pub(super) struct SkyGradient {
    pub(super) grid: u32,
    pub(super) texel: u32,
    pub(super) logits: [f32; 3],
}

/// Buffers of one chunk, reused from step to step.
#[derive(Clone, Debug, Default)]
pub(super) struct Chunk {
    pub(super) samples: Vec<RaySample>,
    pub(super) ray_ends: Vec<u32>,
    pub(super) weights: Vec<f32>,
    pub(super) slots: Vec<u32>,
    pub(super) positions: Vec<Vec3>,
    pub(super) weight_gradient: Vec<f32>,
    pub(super) tau_gradient: Vec<f32>,
    pub(super) batch: MlpBatch,
    pub(super) bf16: Bf16Batch,
    pub(super) points: Vec<PointGradient>,
    /// End of every ray's points.
    pub(super) point_ends: Vec<u32>,
    /// The rays as corrected, and a gradient for each, where views are corrected; else empty.
    pub(super) rays: Vec<TrainRay>,
    pub(super) views: Vec<ViewGradient>,
    /// Per level: (brick, point) for every brick that a point's interpolation reads.
    pub(super) touched: Vec<Vec<(u32, u32)>>,
    pub(super) sky: Vec<SkyGradient>,
    pub(super) sums: StepSums,
}

/// What a chunk needs to know besides its rays.
#[derive(Clone, Copy, Debug)]
pub(super) struct Setting<'a> {
    pub(super) field: &'a Field,
    pub(super) colorist: &'a Colorist,
    pub(super) losses: &'a RayLosses,
    pub(super) corrections: Option<Corrections<'a>>,
    pub(super) simd: Simd,
}

impl Chunk {
    /// Computes all gradients of `rays`.
    pub(super) fn run(&mut self, setting: Setting<'_>, rays: &[TrainRay]) {
        self.clear(setting.field.levels.len());
        let Some(corrections) = setting.corrections else {
            return self.run_corrected(setting, rays);
        };
        self.correct(corrections, rays);
        let rays = std::mem::take(&mut self.rays);
        self.run_corrected(setting, &rays);
        self.rays = rays;
        if corrections.learns_poses {
            self.pose_gradients(setting.field, corrections.views);
        }
    }

    fn run_corrected(&mut self, setting: Setting<'_>, rays: &[TrainRay]) {
        march(setting.simd, self, setting.field, rays);
        self.composite(setting, rays);
        let (positions, rows) = (&self.positions, &mut self.batch.features);
        gather_features(setting.simd, setting.field, positions, rows);
        setting.colorist.forward(&mut self.batch, &mut self.bf16);
        self.differentiate(setting, rays);
        setting.colorist.backward(&mut self.batch, &mut self.bf16);
        find_bricks(setting.simd, self, setting.field);
    }

    fn clear(&mut self, levels: usize) {
        self.samples.clear();
        self.ray_ends.clear();
        self.slots.clear();
        self.positions.clear();
        self.batch.clear();
        self.points.clear();
        self.point_ends.clear();
        self.views.clear();
        self.sky.clear();
        self.sums.clear();
        self.touched.resize_with(levels, Vec::new);
        self.touched.iter_mut().for_each(Vec::clear);
        self.batch.parameter_gradients.fill(0.0);
    }

    /// Weights of all samples, and slots in the colour batch for those that matter to a colour ray.
    fn composite(&mut self, setting: Setting<'_>, rays: &[TrainRay]) {
        self.weights.clear();
        self.weights.resize(self.samples.len(), 0.0);
        let mut start = 0;
        for (ray, end) in rays.iter().zip(&self.ray_ends) {
            let range = start..*end as usize;
            start = range.end;
            volume::weights(
                &self.samples[range.clone()],
                &mut self.weights[range.clone()],
            );
            let before = self.positions.len();
            for i in range {
                let shown = ray.color_weight > 0.0 && self.weights[i] > setting.losses.min_weight;
                self.slots.push(if shown {
                    self.positions.len() as u32
                } else {
                    NO_SLOT
                });
                if shown {
                    self.positions.push(ray.ray.at(self.samples[i].t));
                }
            }
            if self.positions.len() > before {
                let view = encode_view(ray.ray.direction);
                self.batch.views.extend_from_slice(&view);
                self.batch.ray_ends.push(self.positions.len() as u32);
            }
        }
        self.sums.samples = self.samples.len() as u64;
        self.sums.colored = self.positions.len() as u64;
    }
}

dispatch!(fn march => march_all(chunk: &mut Chunk, field: &Field, rays: &[TrainRay]));
dispatch!(fn find_bricks => find_bricks_generic(chunk: &mut Chunk, field: &Field));

#[inline(always)]
fn march_all<L: Lanes, const R: usize, const V: usize>(
    chunk: &mut Chunk,
    field: &Field,
    rays: &[TrainRay],
) {
    let most = MAX_POINTS / rays.len().max(1);
    for ray in rays {
        let start = chunk.samples.len();
        let range = MarchRange {
            t_min: 0.0,
            t_max: ray.t_max,
            stop_tau: STOP_TAU,
            phase: ray.phase,
        };
        let mut tau = 0.0;
        march_generic::<L, R, V>(field, ray.ray, range, &mut chunk.samples, &mut tau);
        chunk.samples.truncate(start + most);
        chunk.ray_ends.push(chunk.samples.len() as u32);
    }
}

/// Lists, per level, the bricks whose nodes each point's gradient goes to.
#[inline(always)]
fn find_bricks_generic<L: Lanes, const R: usize, const V: usize>(chunk: &mut Chunk, field: &Field) {
    assert!(
        chunk.points.len() <= MAX_POINTS,
        "a chunk's points are numbered in 16 bits"
    );
    for (number, points) in chunk.points.chunks(GROUP).enumerate() {
        let mut at = Positions::ZERO;
        for (i, point) in points.iter().enumerate() {
            at.set(i, point.position);
        }
        for (level, touched) in field.levels.iter().zip(&mut chunk.touched) {
            let places = Places::of(level, &at);
            for i in 0..points.len() {
                let (bricks, count) = places.bricks(i, level.index());
                let point = (number * GROUP + i) as u32;
                touched.extend(bricks[..count].iter().map(|brick| (*brick, point)));
            }
        }
    }
}
