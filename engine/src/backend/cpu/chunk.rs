//! Forward and backward of a chunk of rays: march, colour, composite, lose, and turn it all around.

use std::ops::Range;

use glam::Vec3;

use super::lanes::Lanes;
use super::mlp::{MlpBatch, PADDED_FEATURES, TransposedWeights};
use super::simd::{Simd, dispatch};
use crate::field::lattice::{BRICK_NODES, Corners, FEATURES, NULL_BRICK};
use crate::field::mlp::MLP_OUTPUTS;
use crate::field::{Field, MarchRange, RaySample, SkyMap, encode_view};
use crate::train::ray::{Backdrop, RayLosses, Silhouette, StepSums, TrainRay};
use crate::volume;

/// Optical depth at which a ray ends: transmittance 1e-3, as in DVGO.
const STOP_TAU: f32 = 6.9;
/// A sample without colour.
pub(super) const NO_SLOT: u32 = u32::MAX;
/// Points of a chunk are numbered in 16 bits where gradients are sorted.
const MAX_POINTS: usize = 1 << 16;
/// Less transmittance than this tells nothing about the sky.
const MIN_SKY: f32 = 1e-3;

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
    samples: Vec<RaySample>,
    ray_ends: Vec<u32>,
    weights: Vec<f32>,
    slots: Vec<u32>,
    positions: Vec<Vec3>,
    weight_gradient: Vec<f32>,
    tau_gradient: Vec<f32>,
    pub(super) batch: MlpBatch,
    pub(super) points: Vec<PointGradient>,
    /// Per level: (brick, point) for every brick that a point's interpolation reads.
    pub(super) touched: Vec<Vec<(u32, u32)>>,
    pub(super) sky: Vec<SkyGradient>,
    pub(super) sums: StepSums,
}

/// What a chunk needs to know besides its rays.
#[derive(Clone, Copy, Debug)]
pub(super) struct Setting<'a> {
    pub(super) field: &'a Field,
    pub(super) transposed: &'a TransposedWeights,
    pub(super) losses: &'a RayLosses,
    pub(super) simd: Simd,
}

impl Chunk {
    /// Computes all gradients of `rays`.
    pub(super) fn run(&mut self, setting: Setting<'_>, rays: &[TrainRay]) {
        self.clear(setting.field.levels.len());
        march(setting.simd, self, setting.field, rays);
        self.composite(setting, rays);
        gather(setting.simd, self, setting.field);
        self.batch.forward(&setting.field.mlp, setting.simd);
        self.differentiate(setting, rays);
        self.batch.backward(setting.transposed, setting.simd);
        self.find_bricks(setting.field);
    }

    fn clear(&mut self, levels: usize) {
        self.samples.clear();
        self.ray_ends.clear();
        self.slots.clear();
        self.positions.clear();
        self.batch.clear();
        self.points.clear();
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

    /// Losses of every ray and their gradients by colours, densities and sky.
    fn differentiate(&mut self, setting: Setting<'_>, rays: &[TrainRay]) {
        let n = self.samples.len();
        for buffer in [&mut self.weight_gradient, &mut self.tau_gradient] {
            buffer.clear();
            buffer.resize(n, 0.0);
        }
        let colors = &mut self.batch.color_gradients;
        colors.clear();
        colors.resize(self.positions.len() * MLP_OUTPUTS, 0.0);
        let mut start = 0;
        for (number, ray) in rays.iter().enumerate() {
            let range = start..self.ray_ends[number] as usize;
            start = range.end;
            self.differentiate_ray(setting, ray, range);
        }
    }

    fn differentiate_ray(&mut self, setting: Setting<'_>, ray: &TrainRay, range: Range<usize>) {
        let weights = &self.weights[range.clone()];
        let end = (1.0 - weights.iter().sum::<f32>()).max(0.0);
        if ray.color_weight > 0.0 {
            self.color_losses(setting, ray, range.clone(), end);
        }
        // A sample that was not coloured has an unknown colour, not black: colour says nothing about its density.
        let pairs = self.tau_gradient[range.clone()]
            .iter_mut()
            .zip(&self.slots[range.clone()]);
        pairs
            .filter(|(_, slot)| **slot == NO_SLOT)
            .for_each(|(g, _)| *g = 0.0);
        self.shape_losses(setting, ray, range.clone(), end);
        for i in range {
            let (sample, slot) = (self.samples[i], self.slots[i]);
            let slope = sample.dt * setting.field.activation.slope(sample.sigma);
            let raw = self.tau_gradient[i] * slope;
            if raw != 0.0 || slot != NO_SLOT {
                self.points.push(PointGradient {
                    position: ray.ray.at(sample.t),
                    raw,
                    slot,
                });
            }
        }
    }

    /// Losses of the composited colour: gradients by sample colours, sky and, through the weights, by optical depths.
    fn color_losses(
        &mut self,
        setting: Setting<'_>,
        ray: &TrainRay,
        range: Range<usize>,
        end: f32,
    ) {
        let sky = setting.field.sky.as_ref();
        let behind = match (ray.backdrop, sky) {
            (Backdrop::Sky | Backdrop::SkyAsIs, Some(sky)) => sky.color(ray.ray.direction),
            (Backdrop::Sky | Backdrop::SkyAsIs, None) => [0.0; 3],
            (Backdrop::Color(color), _) => color,
        };
        let mut color = behind.map(|c| c * end);
        for i in range.clone().filter(|i| self.slots[*i] != NO_SLOT) {
            let sample = self.batch.color(self.slots[i] as usize);
            (0..3).for_each(|c| color[c] += self.weights[i] * sample[c]);
        }
        let loss = volume::color_loss(color, ray.color);
        self.sums.color_rays += 1;
        self.sums.squared_error += f64::from(loss.value);
        self.sums.loss += f64::from(ray.color_weight * loss.value);
        let gradient = loss.gradient.map(|g| g * ray.color_weight);
        let per_sample = ray.color_weight * setting.losses.sample_color;
        for i in range.clone().filter(|i| self.slots[*i] != NO_SLOT) {
            let slot = self.slots[i] as usize;
            let sample = self.batch.color(slot);
            self.weight_gradient[i] = dot(gradient, sample);
            let own = volume::sample_color_loss(self.weights[i], sample, ray.color).gradient;
            let out = &mut self.batch.color_gradients[slot * MLP_OUTPUTS..][..3];
            (0..3).for_each(|c| out[c] = self.weights[i] * gradient[c] + per_sample * own[c]);
        }
        volume::add_optical_depth_gradient(
            &self.weights[range.clone()],
            &self.weight_gradient[range.clone()],
            end,
            dot(gradient, behind),
            &mut self.tau_gradient[range.clone()],
        );
        self.weight_gradient[range].fill(0.0);
        if let (Backdrop::Sky, Some(sky), true) = (ray.backdrop, sky, end > MIN_SKY) {
            let logits = std::array::from_fn(|c| end * gradient[c] * behind[c] * (1.0 - behind[c]));
            self.sky_gradients(sky, ray.ray.direction, logits);
        }
    }

    fn sky_gradients(&mut self, sky: &SkyMap, direction: Vec3, logits: [f32; 3]) {
        for (grid, map) in sky.grids().iter().enumerate() {
            let at = map.texels(direction);
            for (texel, weight) in at.texels.into_iter().zip(at.weights) {
                self.sky.push(SkyGradient {
                    grid: grid as u32,
                    texel,
                    logits: logits.map(|g| g * weight),
                });
            }
        }
    }

    /// Losses of density alone: range, silhouette and entropy of the remainder.
    fn shape_losses(
        &mut self,
        setting: Setting<'_>,
        ray: &TrainRay,
        range: Range<usize>,
        end: f32,
    ) {
        let losses = setting.losses;
        let mut end_gradient = 0.0;
        if ray.color_weight > 0.0 && losses.entropy > 0.0 {
            end_gradient = ray.color_weight * losses.entropy * volume::entropy_loss(end).gradient;
        }
        if ray.range_weight > 0.0 {
            end_gradient += self.range_losses(losses, ray, range.clone(), end);
        }
        let mut slope = 0.0;
        if ray.silhouette != Silhouette::Unknown {
            let tau: f32 = self.samples[range.clone()]
                .iter()
                .map(|s| s.sigma * s.dt)
                .sum();
            let loss = match ray.silhouette {
                Silhouette::Opaque => volume::opaque_loss(tau),
                _ => volume::transparent_loss(tau),
            };
            self.sums.loss += f64::from(ray.silhouette_weight * loss.value);
            slope = ray.silhouette_weight * loss.gradient;
        }
        if end_gradient == 0.0 && ray.range_weight == 0.0 && slope == 0.0 {
            return;
        }
        let out = &mut self.tau_gradient[range.clone()];
        out.iter_mut().for_each(|g| *g += slope);
        let by_weight = &self.weight_gradient[range.clone()];
        volume::add_optical_depth_gradient(
            &self.weights[range.clone()],
            by_weight,
            end,
            end_gradient,
            out,
        );
        self.weight_gradient[range].fill(0.0);
    }

    /// Expected range error. Fills the gradients by the weights and returns the one by the remainder, charged the cap.
    fn range_losses(
        &mut self,
        losses: &RayLosses,
        ray: &TrainRay,
        range: Range<usize>,
        end: f32,
    ) -> f32 {
        let cap = losses.depth_cap_m;
        let (mut expected, mut composited) = (end * cap, end * (ray.range_m + cap));
        for i in range.clone() {
            let t = self.samples[i].t;
            let error = volume::depth_loss(t, ray.range_m, losses.depth_scale_m)
                .value
                .min(cap);
            expected += self.weights[i] * error;
            composited += self.weights[i] * t;
            self.weight_gradient[i] = ray.range_weight * error;
        }
        self.sums
            .range_errors_m
            .push((composited - ray.range_m).abs());
        if expected > losses.depth_trim_m {
            self.weight_gradient[range].fill(0.0);
            return 0.0;
        }
        self.sums.loss += f64::from(ray.range_weight * expected);
        ray.range_weight * cap
    }

    /// Lists, per level, the bricks whose nodes each point's gradient goes to.
    fn find_bricks(&mut self, field: &Field) {
        assert!(
            self.points.len() <= MAX_POINTS,
            "a chunk's points are numbered in 16 bits"
        );
        for (level, touched) in field.levels.iter().zip(&mut self.touched) {
            for (number, point) in self.points.iter().enumerate() {
                let Some(corners) = level.corners(point.position) else {
                    continue;
                };
                let first = corners.nodes[0] / BRICK_NODES as u32;
                let last = corners.nodes[7] / BRICK_NODES as u32;
                if first == last && first != NULL_BRICK {
                    touched.push((first, number as u32));
                } else {
                    add_each_brick(&corners, number as u32, touched);
                }
            }
        }
    }
}

/// Corners 0 and 7 differ in every axis that crosses a brick's face, so only then are the other six looked at.
fn add_each_brick(corners: &Corners, point: u32, touched: &mut Vec<(u32, u32)>) {
    let bricks = corners.nodes.map(|node| node / BRICK_NODES as u32);
    for (corner, brick) in bricks.iter().enumerate() {
        if *brick != NULL_BRICK && !bricks[..corner].contains(brick) {
            touched.push((*brick, point));
        }
    }
}

fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

dispatch!(fn march => march_generic(chunk: &mut Chunk, field: &Field, rays: &[TrainRay]));
dispatch!(fn gather => gather_generic(chunk: &mut Chunk, field: &Field));

#[inline(always)]
fn march_generic<L: Lanes, const R: usize, const V: usize>(
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
        field.march_ray(ray.ray, range, &mut chunk.samples);
        chunk.samples.truncate(start + most);
        chunk.ray_ends.push(chunk.samples.len() as u32);
    }
}

#[inline(always)]
fn gather_generic<L: Lanes, const R: usize, const V: usize>(chunk: &mut Chunk, field: &Field) {
    let out = &mut chunk.batch.features;
    out.resize(chunk.positions.len() * PADDED_FEATURES, 0.0);
    for (p, out) in chunk
        .positions
        .iter()
        .zip(out.chunks_exact_mut(PADDED_FEATURES))
    {
        out[..FEATURES].copy_from_slice(&field.features(*p));
    }
}
