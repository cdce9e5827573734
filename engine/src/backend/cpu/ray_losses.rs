//! Losses of a chunk's rays and their gradients by colours, densities and sky.

use std::ops::Range;

use glam::Vec3;

use super::chunk::{Chunk, NO_SLOT, PointGradient, Setting, SkyGradient};
use super::view_corrections::ViewGradient;
use crate::field::SkyMap;
use crate::field::mlp::MLP_OUTPUTS;
use crate::train::ray::{Backdrop, DepthForm, RayLosses, Rectified, Silhouette, TrainRay};
use crate::volume::{self, Exposure};

/// Less transmittance than this tells nothing about the sky.
const MIN_SKY: f32 = 1e-3;

impl Chunk {
    /// Losses of every ray and their gradients by colours, densities and sky.
    pub(super) fn differentiate(&mut self, setting: Setting<'_>, rays: &[TrainRay]) {
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
            if setting.corrections.is_some() {
                self.views.push(ViewGradient {
                    view: ray.view,
                    ray: number as u32,
                    ..Default::default()
                });
            }
            self.differentiate_ray(setting, ray, range);
            self.point_ends.push(self.points.len() as u32);
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
        let exposure = setting
            .corrections
            .map(|c| c.views[ray.view as usize].exposure);
        let corrected = exposure.map_or(color, |exposure| exposure.apply(color));
        let loss = volume::color_loss(corrected, ray.color);
        self.sums.color_rays += 1;
        self.sums.squared_error += f64::from(loss.value);
        self.sums.loss += f64::from(ray.color_weight * loss.value);
        let mut gradient = loss.gradient.map(|g| g * ray.color_weight);
        if let Some(exposure) = exposure {
            gradient = self.exposure_gradient(exposure, color, gradient);
        }
        let per_sample = ray.color_weight * setting.losses.sample_color;
        for i in range.clone() {
            if self.slots[i] == NO_SLOT {
                continue;
            }
            let slot = self.slots[i] as usize;
            let sample = self.batch.color(slot);
            self.weight_gradient[i] = dot(gradient, sample);
            let corrected = exposure.map_or(sample, |exposure| exposure.apply(sample));
            let own = volume::sample_color_loss(self.weights[i], corrected, ray.color).gradient;
            let mut own = own.map(|g| g * per_sample);
            if let Some(exposure) = exposure {
                own = self.exposure_gradient(exposure, sample, own);
            }
            let out = &mut self.batch.color_gradients[slot * MLP_OUTPUTS..][..3];
            (0..3).for_each(|c| out[c] = self.weights[i] * gradient[c] + own[c]);
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

    /// Adds the present ray's gradient by exposure and returns the one by the colour before it.
    fn exposure_gradient(
        &mut self,
        exposure: Exposure,
        color: [f32; 3],
        by_corrected: [f32; 3],
    ) -> [f32; 3] {
        let gradient = exposure.gradient(color, by_corrected);
        let sum = &mut self.views.last_mut().expect("one per ray").exposure;
        (0..3).for_each(|c| sum.log_gain[c] += gradient.log_gain[c]);
        (0..3).for_each(|c| sum.bias[c] += gradient.bias[c]);
        gradient.color
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

    /// Losses of density alone: range, silhouette, distortion and entropy of the remainder.
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
        let distorts = ray.color_weight > 0.0 && losses.distortion > 0.0;
        if distorts {
            self.distortion_loss(losses, ray, range.clone());
        }
        let mut slope = 0.0;
        if ray.silhouette != Silhouette::Unknown {
            let tau: f32 = self.samples[range.clone()]
                .iter()
                .map(|s| s.sigma * s.dt)
                .sum();
            let loss = match (losses.rectified, ray.silhouette) {
                (Rectified::Printed, _) => volume::printed_rectified_loss(tau),
                (_, Silhouette::Opaque) => volume::opaque_loss(tau),
                _ => volume::transparent_loss(tau),
            };
            self.sums.loss += f64::from(ray.silhouette_weight * loss.value);
            slope = ray.silhouette_weight * loss.gradient;
        }
        if end_gradient == 0.0 && ray.range_weight == 0.0 && slope == 0.0 && !distorts {
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

    /// Adds the distortion loss's gradient by the weights.
    fn distortion_loss(&mut self, losses: &RayLosses, ray: &TrainRay, range: Range<usize>) {
        let factor = ray.color_weight * losses.distortion;
        let (weights, samples) = (&self.weights[range.clone()], &self.samples[range.clone()]);
        let warped = weights.iter().zip(samples).map(|(weight, sample)| {
            let (s, slope) = volume::warped(sample.t, losses.distortion_scale_m);
            (*weight, s, slope * sample.dt)
        });
        let out = &mut self.weight_gradient[range];
        let loss = volume::add_distortion_gradient(warped, factor, out);
        self.sums.loss += f64::from(factor * loss);
    }

    /// Range error. Fills the gradients by the weights and returns the one by the remainder.
    fn range_losses(
        &mut self,
        losses: &RayLosses,
        ray: &TrainRay,
        range: Range<usize>,
        end: f32,
    ) -> f32 {
        let behind_m = ray.range_m + losses.depth_cap_m;
        let pairs = self.weights[range.clone()]
            .iter()
            .zip(&self.samples[range.clone()]);
        let composited = pairs.fold(end * behind_m, |sum, (w, sample)| sum + w * sample.t);
        self.sums
            .range_errors_m
            .push((composited - ray.range_m).abs());
        match losses.depth {
            DepthForm::Expected => self.expected_range_loss(losses, ray, range, end),
            DepthForm::CompositedL1 => {
                let loss = volume::composited_depth_loss(composited, ray.range_m);
                if loss.value > losses.depth_trim_m {
                    return 0.0;
                }
                self.sums.loss += f64::from(ray.range_weight * loss.value);
                let slope = ray.range_weight * loss.gradient;
                let samples = &self.samples[range.clone()];
                let pairs = self.weight_gradient[range].iter_mut().zip(samples);
                pairs.for_each(|(gradient, sample)| *gradient = slope * sample.t);
                slope * behind_m
            }
        }
    }

    /// The remainder is charged the cap.
    fn expected_range_loss(
        &mut self,
        losses: &RayLosses,
        ray: &TrainRay,
        range: Range<usize>,
        end: f32,
    ) -> f32 {
        let cap = losses.depth_cap_m;
        let mut expected = end * cap;
        for i in range.clone() {
            let t = self.samples[i].t;
            let error = volume::depth_loss(t, ray.range_m, losses.depth_scale_m)
                .value
                .min(cap);
            expected += self.weights[i] * error;
            self.weight_gradient[i] = ray.range_weight * error;
        }
        if expected > losses.depth_trim_m {
            self.weight_gradient[range].fill(0.0);
            return 0.0;
        }
        self.sums.loss += f64::from(ray.range_weight * expected);
        ray.range_weight * cap
    }
}

fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}
