//! The whole training loss in f64, straight from the formulas, and its gradient by differences: the oracle of the f32 path.

use glam::{DQuat, DVec3, Vec3};

use super::Simd;
use super::chunk::{Chunk, NO_SLOT, Setting};
use super::colorist::Colorist;
use super::mlp::PADDED_FEATURES;
use super::view_corrections::{Corrections, ViewCorrection};
use crate::field::lattice::{BRICK_NODES, Lattice, NULL_BRICK};
use crate::field::mlp::{MLP_INPUTS, MLP_OUTPUTS};
use crate::field::{FEATURES, Field, MarchRange, RaySample, encode_view};
use crate::scene::Draws;
use crate::train::ray::{Backdrop, DepthForm, RayLosses, Rectified, Silhouette, TrainRay};

const H: f64 = 1e-5;
/// Parameters of a view: log gain, bias, small rotation, translation.
const VIEW: usize = 12;

/// A field, rays and losses whose gradients are checked. Views are corrected if there are corrections.
#[derive(Clone, Debug)]
pub(in crate::backend) struct Scene {
    pub(in crate::backend) field: Field,
    pub(in crate::backend) rays: Vec<TrainRay>,
    pub(in crate::backend) losses: RayLosses,
    pub(in crate::backend) corrections: Vec<ViewCorrection>,
}

/// Where the kinds of parameters start in the vector of all of them.
pub(in crate::backend) struct Offsets {
    /// Density and features of each level.
    pub(in crate::backend) levels: Vec<(usize, usize)>,
    pub(in crate::backend) mlp: usize,
    pub(in crate::backend) sky: usize,
    pub(in crate::backend) views: usize,
}

/// All parameters of a field in one vector: densities, features, network, sky.
pub(in crate::backend) fn parameters(field: &Field) -> Vec<f64> {
    let mut all: Vec<f32> = Vec::new();
    for level in &field.levels {
        all.extend(level.density());
        all.extend(level.features().as_flattened());
    }
    all.extend(field.mlp.parameters());
    let sky = field.sky.as_ref().expect("the scene has a sky");
    all.extend(sky.grids()[0].logits().as_flattened());
    all.into_iter().map(f64::from).collect()
}

pub(in crate::backend) fn offsets(field: &Field) -> Offsets {
    let mut at = 0;
    let mut levels = Vec::new();
    for level in &field.levels {
        let nodes = level.density().len();
        levels.push((at, at + nodes));
        at += nodes * (1 + FEATURES);
    }
    let sky = at + field.mlp.parameters().len();
    Offsets {
        levels,
        mlp: at,
        sky,
        views: sky + 3 * sky_texels(field),
    }
}

fn sky_texels(field: &Field) -> usize {
    let sky = field.sky.as_ref().expect("the scene has a sky");
    sky.grids()[0].logits().len()
}

impl Scene {
    /// The f32 path's gradients.
    pub(super) fn run(&self, simd: Simd) -> Chunk {
        let colorist = Colorist::exact(&self.field.mlp, simd);
        let mut chunk = Chunk::default();
        let setting = Setting {
            field: &self.field,
            colorist: &colorist,
            losses: &self.losses,
            corrections: (!self.corrections.is_empty()).then_some(Corrections {
                views: &self.corrections,
                learns_poses: true,
            }),
            simd,
        };
        chunk.run(setting, &self.rays);
        chunk
    }

    /// The chunk's gradients by all parameters, spread over nodes in the plainest way.
    pub(super) fn dense_gradient(&self, chunk: &Chunk) -> Vec<f64> {
        let at = offsets(&self.field);
        let mut out = vec![0.0; at.views + VIEW * self.corrections.len()];
        for (level, (density_at, features_at)) in self.field.levels.iter().zip(&at.levels) {
            for point in &chunk.points {
                for (node, weight) in corners(level, point.position.as_dvec3()) {
                    out[density_at + node] += weight * f64::from(point.raw);
                    if point.slot != NO_SLOT {
                        let row = point.slot as usize * PADDED_FEATURES;
                        for f in 0..FEATURES {
                            let gradient = f64::from(chunk.batch.feature_gradients[row + f]);
                            out[features_at + node * FEATURES + f] += weight * gradient;
                        }
                    }
                }
            }
        }
        for (i, g) in chunk.batch.parameter_gradients.iter().enumerate() {
            out[at.mlp + i] = f64::from(*g);
        }
        for texel in &chunk.sky {
            let first = at.sky + texel.texel as usize * 3;
            (0..3).for_each(|c| out[first + c] += f64::from(texel.logits[c]));
        }
        for gradient in &chunk.views {
            let parts = [
                gradient.exposure.log_gain,
                gradient.exposure.bias,
                gradient.rotation.into(),
                gradient.translation.into(),
            ];
            let sums = &mut out[at.views + VIEW * gradient.view as usize..];
            for (sum, part) in sums.iter_mut().zip(parts.as_flattened()) {
                *sum += f64::from(*part);
            }
        }
        out
    }

    /// Largest error of `gradient` against differences, relative to the largest difference of the same kind of parameter.
    pub(in crate::backend) fn worst_error(&self, gradient: &[f64]) -> f64 {
        let march = |ray: &TrainRay| {
            let mut out = Vec::new();
            let range = MarchRange {
                t_min: 0.0,
                t_max: ray.t_max,
                stop_tau: 6.9,
                phase: ray.phase,
            };
            self.field.march_ray(ray.ray, range, &mut out);
            out
        };
        let rays = self.corrected_rays();
        let samples: Vec<Vec<RaySample>> = rays.iter().map(march).collect();
        let loss = |p: &[f64]| self.loss(&rays, &samples, p);
        let mut p = parameters(&self.field);
        p.resize(gradient.len(), 0.0);
        let mut draws = Draws::new(8, 0, 0);
        let mut worst: f64 = 0.0;
        for kind in self.kinds(gradient.len()).windows(2) {
            let moved: Vec<usize> = (kind[0]..kind[1])
                .filter(|i| gradient[*i] != 0.0 && !self.is_padding(*i))
                .collect();
            assert!(!moved.is_empty(), "nothing moves {kind:?}");
            let chosen: Vec<usize> = (0..24).map(|_| moved[draws.below(moved.len())]).collect();
            let difference = |i: &usize| {
                let mut p = p.clone();
                p[*i] += H;
                let high = loss(&p);
                p[*i] -= 2.0 * H;
                (high - loss(&p)) / (2.0 * H)
            };
            let numeric: Vec<f64> = chosen.iter().map(difference).collect();
            let scale = numeric.iter().fold(1e-12, |m: f64, x| m.max(x.abs()));
            for (i, n) in chosen.iter().zip(&numeric) {
                worst = worst.max((gradient[*i] - n).abs() / scale);
            }
        }
        worst
    }

    /// Bounds of the kinds of parameters: each level's densities and features, network, sky, and the views' if corrected.
    fn kinds(&self, count: usize) -> Vec<usize> {
        let at = offsets(&self.field);
        let mut bounds: Vec<usize> = at.levels.iter().flat_map(|(d, f)| [*d, *f]).collect();
        bounds.extend([at.mlp, at.sky, at.views]);
        if count > at.views {
            bounds.push(count);
        }
        bounds
    }

    /// The network's fourth output is padding and moves no loss.
    fn is_padding(&self, parameter: usize) -> bool {
        let (at, layout) = (offsets(&self.field), self.field.mlp.layout());
        let first = at.mlp + layout.w3().start;
        (first..at.sky).contains(&parameter) && (parameter - first) % MLP_OUTPUTS == 3
    }

    /// The rays as the present corrections move them.
    pub(in crate::backend) fn corrected_rays(&self) -> Vec<TrainRay> {
        let corrected = |ray: &TrainRay| match self.corrections.get(ray.view as usize) {
            Some(view) => TrainRay {
                ray: view.pose.apply(ray.ray, ray.mirrored),
                ..*ray
            },
            None => *ray,
        };
        self.rays.iter().map(corrected).collect()
    }

    /// Sample distances are those of the f32 march, which no parameter moves; so is the direction the network is told.
    fn loss(&self, rays: &[TrainRay], samples: &[Vec<RaySample>], p: &[f64]) -> f64 {
        let pairs = rays.iter().zip(samples);
        pairs
            .map(|(ray, samples)| self.ray_loss(ray, samples, p))
            .sum()
    }

    fn ray_loss(&self, ray: &TrainRay, samples: &[RaySample], p: &[f64]) -> f64 {
        let losses = &self.losses;
        let at = offsets(&self.field);
        let view = self.corrections.get(ray.view as usize).map(|base| {
            let moves: [f64; VIEW] =
                std::array::from_fn(|i| p[at.views + VIEW * ray.view as usize + i]);
            (base, moves)
        });
        let expose = |color: [f64; 3]| -> [f64; 3] {
            std::array::from_fn(|c| match view {
                None => color[c],
                Some((base, moves)) => {
                    let gain = f64::from(base.exposure.log_gain[c]) + moves[c];
                    gain.exp() * color[c] + f64::from(base.exposure.bias[c]) + moves[3 + c]
                }
            })
        };
        let target = ray.color.map(f64::from);
        let error = |color: [f64; 3]| {
            let color = expose(color);
            (0..3).map(|c| (color[c] - target[c]).powi(2)).sum::<f64>()
        };
        let (mut transmittance, mut tau) = (1.0, 0.0);
        let (mut color, mut own) = ([0.0; 3], 0.0);
        let mut weights = Vec::new();
        for sample in samples {
            let recorded =
                ray.ray.origin.as_dvec3() + ray.ray.direction.as_dvec3() * f64::from(sample.t);
            let position = view.map_or(recorded, |(base, moves)| {
                moved(recorded, base, &moves, ray.mirrored)
            });
            let (raw, features) = self.interpolated(position, p);
            let activation = self.field.activation;
            let sigma = (raw + f64::from(activation.act_shift)).exp().ln_1p()
                / f64::from(activation.base_voxel_m);
            let depth = sigma * f64::from(sample.dt);
            let weight = transmittance * (1.0 - (-depth).exp());
            transmittance *= (-depth).exp();
            tau += depth;
            weights.push(weight);
            if ray.color_weight > 0.0 {
                let seen = self.color(&features, ray.ray.direction, p);
                (0..3).for_each(|c| color[c] += weight * seen[c]);
                own += held_weight(samples, sample) * error(seen);
            }
        }
        let mut total = 0.0;
        if ray.color_weight > 0.0 {
            let behind = self.behind(ray, p);
            (0..3).for_each(|c| color[c] += transmittance * behind[c]);
            let entropy = -(transmittance * transmittance.ln()
                + (1.0 - transmittance) * (1.0 - transmittance).ln());
            total += f64::from(ray.color_weight)
                * (error(color) / 3.0
                    + f64::from(losses.sample_color) * own
                    + f64::from(losses.entropy) * entropy
                    + f64::from(losses.distortion) * self.distortion(samples, &weights));
        }
        if ray.range_weight > 0.0 {
            total += f64::from(ray.range_weight)
                * self.range_loss(ray, samples, &weights, transmittance);
        }
        let hit = -(1.0 - (-tau).exp()).ln();
        total
            + f64::from(ray.silhouette_weight)
                * match (losses.rectified, ray.silhouette) {
                    (_, Silhouette::Unknown) => 0.0,
                    (Rectified::CrossEntropy, Silhouette::Transparent) => tau,
                    _ => hit,
                }
    }

    fn distortion(&self, samples: &[RaySample], weights: &[f64]) -> f64 {
        let scale = f64::from(self.losses.distortion_scale_m);
        let at = |sample: &RaySample| f64::from(sample.t) / (f64::from(sample.t) + scale);
        let mut sum = 0.0;
        for (a, wa) in samples.iter().zip(weights) {
            for (b, wb) in samples.iter().zip(weights) {
                sum += wa * wb * (at(a) - at(b)).abs();
            }
            let length = scale * f64::from(a.dt) / (f64::from(a.t) + scale).powi(2);
            sum += wa * wa * length / 3.0;
        }
        sum
    }

    fn range_loss(&self, ray: &TrainRay, samples: &[RaySample], weights: &[f64], end: f64) -> f64 {
        let (scale, cap) = (
            f64::from(self.losses.depth_scale_m),
            f64::from(self.losses.depth_cap_m),
        );
        let wanted = f64::from(ray.range_m);
        let pairs = samples.iter().map(|s| f64::from(s.t)).zip(weights);
        match self.losses.depth {
            DepthForm::CompositedL1 => {
                let range = pairs.map(|(t, w)| w * t).sum::<f64>() + end * (wanted + cap);
                (range - wanted).abs()
            }
            DepthForm::Expected => {
                let huber = |error: f64| {
                    if error < scale {
                        error * error / (2.0 * scale)
                    } else {
                        error - scale / 2.0
                    }
                };
                let each = pairs.map(|(t, w)| w * huber((t - wanted).abs()).min(cap));
                each.sum::<f64>() + end * cap
            }
        }
    }

    /// Raw density and features at a position.
    fn interpolated(&self, position: DVec3, p: &[f64]) -> (f64, Vec<f64>) {
        let (mut raw, mut features) = (0.0, vec![0.0; FEATURES]);
        let at = offsets(&self.field);
        for (level, (density_at, features_at)) in self.field.levels.iter().zip(&at.levels) {
            for (node, weight) in corners(level, position) {
                raw += weight * p[density_at + node];
                let stored = &p[features_at + node * FEATURES..][..FEATURES];
                let sums = features.iter_mut().zip(stored);
                sums.for_each(|(sum, value)| *sum += weight * value);
            }
        }
        (raw, features)
    }

    fn color(&self, features: &[f64], direction: Vec3, p: &[f64]) -> [f64; 3] {
        let mut input = features.to_vec();
        input.extend(encode_view(direction).map(f64::from));
        assert_eq!(input.len(), MLP_INPUTS);
        let (first, layout) = (offsets(&self.field).mlp, self.field.mlp.layout());
        let affine = |w: std::ops::Range<usize>, b: std::ops::Range<usize>, x: &[f64]| {
            let (weights, out) = (first + w.start, b.len());
            let row = |o: usize| {
                let products = (0..x.len()).map(|i| x[i] * p[weights + i * out + o]);
                p[first + b.start + o] + products.sum::<f64>()
            };
            (0..out).map(row).collect::<Vec<f64>>()
        };
        let relu = |x: Vec<f64>| x.into_iter().map(|x| x.max(0.0)).collect::<Vec<_>>();
        let hidden = relu(affine(layout.w1(), layout.b1(), &input));
        let hidden = relu(affine(layout.w2(), layout.b2(), &hidden));
        let out = affine(layout.w3(), layout.b3(), &hidden);
        std::array::from_fn(|c| sigmoid(out[c]))
    }

    fn behind(&self, ray: &TrainRay, p: &[f64]) -> [f64; 3] {
        let Backdrop::Color(color) = ray.backdrop else {
            let sky = self.field.sky.as_ref().expect("the scene has a sky");
            let texels = sky.grids()[0].texels(ray.ray.direction);
            let first = offsets(&self.field).sky;
            return std::array::from_fn(|c| {
                let logits = texels.texels.iter().zip(texels.weights);
                let logit = logits.map(|(t, w)| f64::from(w) * p[first + *t as usize * 3 + c]);
                sigmoid(logit.sum())
            });
        };
        color.map(f64::from)
    }
}

fn sigmoid(x: f64) -> f64 {
    1.0 / (1.0 + (-x).exp())
}

/// The weight of the per-sample colour loss is held constant: that of the f32 forward pass.
fn held_weight(samples: &[RaySample], of: &RaySample) -> f64 {
    let before: f64 = samples
        .iter()
        .take_while(|s| s.t < of.t)
        .map(|s| f64::from(s.sigma * s.dt))
        .sum();
    (-before).exp() * (1.0 - (-f64::from(of.sigma * of.dt)).exp())
}

/// A point of a corrected ray after the small move `moves` of its view's pose.
fn moved(p: DVec3, base: &ViewCorrection, moves: &[f64; VIEW], is_mirrored: bool) -> DVec3 {
    let mirror = if is_mirrored { -1.0 } else { 1.0 };
    let recorded = DVec3::new(p.x, mirror * p.y, p.z);
    let centre = base.pose.translation_m.as_dvec3();
    let turn = DQuat::from_scaled_axis(DVec3::new(moves[6], moves[7], moves[8]));
    let shift = DVec3::new(moves[9], moves[10], moves[11]);
    let out = turn * (recorded - centre) + centre + shift;
    DVec3::new(out.x, mirror * out.y, out.z)
}

/// Stored nodes around `p` and their trilinear weights, in f64.
fn corners(level: &Lattice, p: DVec3) -> Vec<(usize, f64)> {
    let q = (p - level.origin_m().as_dvec3()) / f64::from(level.voxel_m());
    let base = q.floor();
    let mut out = Vec::new();
    for corner in 0..8 {
        let step = DVec3::new(
            f64::from(corner & 1),
            f64::from(corner >> 1 & 1),
            f64::from(corner >> 2),
        );
        let weight = (DVec3::ONE - (base + step - q).abs()).element_product();
        let node = (base + step).as_ivec3();
        if node.min_element() < 0 {
            continue;
        }
        let brick = level.brick((node / 8).to_array().map(|c| c as u16));
        let local = node % 8;
        let local = ((local.z * 8 + local.y) * 8 + local.x) as usize;
        if brick != NULL_BRICK {
            out.push((brick as usize * BRICK_NODES + local, weight));
        }
    }
    out
}
