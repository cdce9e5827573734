//! Exposure and pose of every view, learned beside the field.
//!
//! A view's exposure maps the composited colour before it is compared; a view's pose correction moves its rays within the
//! field's frame (for objects: jitter of annotated cuboids). Both are kept at mean identity over the views, so that the
//! field's own brightness and place stay defined. They serve training only and are stored nowhere.

use glam::{Quat, Vec3};

use super::adam::Adam;
use super::chunk::{Chunk, NO_SLOT};
use super::mlp::PADDED_FEATURES;
use crate::field::lattice::{FEATURES, Lattice};
use crate::field::{Field, Ray};
use crate::train::ray::{Rates, RayLosses, TrainRay};
use crate::volume::{Exposure, ExposureGradient};

/// Rotations move by the pose rate over this arm: half a car, so that both move its surface alike.
pub(in crate::backend) const ARM_M: f32 = 2.0;

/// What is corrected about one view.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ViewCorrection {
    pub exposure: Exposure,
    pub pose: PoseCorrection,
}

/// `corrected_from_recorded` in the field's frame: `p' = rotation p + translation_m`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PoseCorrection {
    pub rotation: Quat,
    pub translation_m: Vec3,
}

impl PoseCorrection {
    /// Moves a ray. A mirrored ray is moved where it was recorded, then mirrored again.
    pub(super) fn apply(&self, ray: Ray, is_mirrored: bool) -> Ray {
        let at = |v: Vec3| if is_mirrored { reflected(v) } else { v };
        Ray {
            origin: at(self.rotation * at(ray.origin) + self.translation_m),
            direction: at(self.rotation * at(ray.direction)),
        }
    }
}

fn reflected(v: Vec3) -> Vec3 {
    Vec3::new(v.x, -v.y, v.z)
}

/// Gradients of one ray's losses by its view's correction.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct ViewGradient {
    pub(super) view: u32,
    /// Its number within the chunk.
    pub(super) ray: u32,
    pub(super) exposure: ExposureGradient,
    /// By a small rotation (rad) applied after the present one, and by the translation.
    pub(super) rotation: Vec3,
    pub(super) translation: Vec3,
}

/// What a chunk needs to know of the corrections.
#[derive(Clone, Copy, Debug)]
pub(super) struct Corrections<'a> {
    pub(super) views: &'a [ViewCorrection],
    pub(super) learns_poses: bool,
}

/// Corrections of all views with their optimiser state.
#[derive(Clone, Debug, Default)]
pub(super) struct ViewOptimizer {
    views: Vec<ViewCorrection>,
    /// Views that had a ray so far; the means are over these.
    seen: Vec<bool>,
    exposure: Adam,
    pose: Adam,
    gradients: Vec<[f32; 6]>,
    steps: Vec<[f32; 6]>,
    learns_poses: bool,
}

impl ViewOptimizer {
    /// Makes room for the views of `rays` if any rate asks for it.
    pub(super) fn prepare(&mut self, rays: &[TrainRay], rates: Rates) {
        self.learns_poses = rates.pose_m > 0.0;
        if rates.exposure > 0.0 || rates.pose_m > 0.0 {
            let most = rays.iter().map(|ray| ray.view as usize + 1).max();
            let count = most.unwrap_or(0).max(self.views.len());
            self.views.resize_with(count, Default::default);
            self.seen.resize(count, false);
        }
    }

    pub(super) fn views(&self) -> &[ViewCorrection] {
        &self.views
    }

    /// `None` while nothing is corrected.
    pub(super) fn corrections(&self) -> Option<Corrections<'_>> {
        (!self.views.is_empty()).then_some(Corrections {
            views: &self.views,
            learns_poses: self.learns_poses,
        })
    }

    /// Sums the chunks' gradients, moves the corrections against them, and takes their mean out.
    pub(super) fn step(&mut self, chunks: &[Chunk], losses: &RayLosses, rates: Rates) {
        for gradient in chunks.iter().flat_map(|chunk| &chunk.views) {
            self.seen[gradient.view as usize] = true;
        }
        if rates.exposure > 0.0 {
            self.step_exposures(chunks, losses.exposure_prior, rates.exposure);
        }
        if rates.pose_m > 0.0 {
            self.step_poses(chunks, losses.pose_prior, rates.pose_m);
        }
    }

    fn step_exposures(&mut self, chunks: &[Chunk], prior: f32, rate: f32) {
        self.sum(chunks, |g| joined(g.exposure.log_gain, g.exposure.bias));
        for (gradient, view) in self.gradients.iter_mut().zip(&self.views) {
            let value = joined(view.exposure.log_gain, view.exposure.bias);
            (0..6).for_each(|i| gradient[i] += prior * value[i]);
        }
        self.adam_steps(rate, |this| &mut this.exposure);
        for ((view, step), seen) in self.views.iter_mut().zip(&self.steps).zip(&self.seen) {
            if *seen {
                (0..3).for_each(|c| view.exposure.log_gain[c] += step[c]);
                (0..3).for_each(|c| view.exposure.bias[c] += step[3 + c]);
            }
        }
        let mean = self.mean(|view| joined(view.exposure.log_gain, view.exposure.bias));
        for (view, _) in self.views.iter_mut().zip(&self.seen).filter(|v| *v.1) {
            (0..3).for_each(|c| view.exposure.log_gain[c] -= mean[c]);
            (0..3).for_each(|c| view.exposure.bias[c] -= mean[3 + c]);
        }
    }

    fn step_poses(&mut self, chunks: &[Chunk], prior: f32, rate_m: f32) {
        self.sum(chunks, |g| {
            joined((g.rotation / ARM_M).into(), g.translation.into())
        });
        for (gradient, view) in self.gradients.iter_mut().zip(&self.views) {
            let rotation = view.pose.rotation.to_scaled_axis() * ARM_M;
            let value = joined(rotation.into(), view.pose.translation_m.into());
            (0..6).for_each(|i| gradient[i] += prior * value[i]);
        }
        self.adam_steps(rate_m, |this| &mut this.pose);
        for ((view, step), seen) in self.views.iter_mut().zip(&self.steps).zip(&self.seen) {
            if *seen {
                let turn = Vec3::new(step[0], step[1], step[2]) / ARM_M;
                view.pose.rotation = Quat::from_scaled_axis(turn) * view.pose.rotation;
                view.pose.translation_m += Vec3::new(step[3], step[4], step[5]);
            }
        }
        let mean = self.mean(|view| {
            let rotation = view.pose.rotation.to_scaled_axis();
            joined(rotation.into(), view.pose.translation_m.into())
        });
        let back = Quat::from_scaled_axis(-Vec3::new(mean[0], mean[1], mean[2]));
        for (view, _) in self.views.iter_mut().zip(&self.seen).filter(|v| *v.1) {
            view.pose.rotation = (back * view.pose.rotation).normalize();
            view.pose.translation_m -= Vec3::new(mean[3], mean[4], mean[5]);
        }
    }

    fn sum(&mut self, chunks: &[Chunk], part: impl Fn(&ViewGradient) -> [f32; 6]) {
        self.gradients.clear();
        self.gradients.resize(self.views.len(), [0.0; 6]);
        for gradient in chunks.iter().flat_map(|chunk| &chunk.views) {
            let sum = &mut self.gradients[gradient.view as usize];
            let part = part(gradient);
            (0..6).for_each(|i| sum[i] += part[i]);
        }
    }

    /// Turns the summed gradients, less their mean, into steps, which start from 0 each time. A common move would be taken
    /// back anyway, but Adam would spend its whole step on it.
    fn adam_steps(&mut self, rate: f32, adam: impl Fn(&mut Self) -> &mut Adam) {
        let mut steps = std::mem::take(&mut self.steps);
        steps.clear();
        steps.resize(self.views.len(), [0.0; 6]);
        let mut gradients = std::mem::take(&mut self.gradients);
        let seen = self.seen.iter().filter(|seen| **seen).count().max(1) as f32;
        for i in 0..6 {
            let mean = gradients.iter().map(|g| g[i]).sum::<f32>() / seen;
            let pairs = gradients.iter_mut().zip(&self.seen);
            pairs.filter(|g| *g.1).for_each(|(g, _)| g[i] -= mean);
        }
        adam(self).step(steps.as_flattened_mut(), gradients.as_flattened(), rate);
        (self.steps, self.gradients) = (steps, gradients);
    }

    fn mean(&self, value: impl Fn(&ViewCorrection) -> [f32; 6]) -> [f32; 6] {
        let mut sum = [0.0; 6];
        let mut count = 0.0f32;
        for (view, _) in self.views.iter().zip(&self.seen).filter(|v| *v.1) {
            let value = value(view);
            (0..6).for_each(|i| sum[i] += value[i]);
            count += 1.0;
        }
        sum.map(|s| s / count.max(1.0))
    }
}

fn joined(a: [f32; 3], b: [f32; 3]) -> [f32; 6] {
    [a[0], a[1], a[2], b[0], b[1], b[2]]
}

impl Chunk {
    /// Replaces `self.rays` by `rays` as their views' corrections move them.
    pub(super) fn correct(&mut self, corrections: Corrections<'_>, rays: &[TrainRay]) {
        self.rays.clear();
        self.rays.extend(rays.iter().map(|ray| {
            let pose = corrections.views[ray.view as usize].pose;
            TrainRay {
                ray: pose.apply(ray.ray, ray.mirrored),
                ..*ray
            }
        }));
    }

    /// Gradients by pose, from those by density and features through the interpolation of both. Where along the ray the
    /// samples lie, and the direction that the colour network is told, are held constant.
    pub(super) fn pose_gradients(&mut self, field: &Field, views: &[ViewCorrection]) {
        let mut start = 0;
        for (gradient, end) in self.views.iter_mut().zip(&self.point_ends) {
            let points = &self.points[start..*end as usize];
            start = *end as usize;
            let (view, is_mirrored) = (
                gradient.view as usize,
                self.rays[gradient.ray as usize].mirrored,
            );
            for point in points {
                let row = (point.slot != NO_SLOT).then(|| {
                    let at = point.slot as usize * PADDED_FEATURES;
                    &self.batch.feature_gradients[at..at + FEATURES]
                });
                let slope = |level: &Lattice| slope(level, point.position, point.raw, row);
                let mut by_position: Vec3 = field.levels.iter().map(slope).sum();
                let mut position = point.position;
                if is_mirrored {
                    by_position = reflected(by_position);
                    position = reflected(position);
                }
                gradient.translation += by_position;
                gradient.rotation += (position - views[view].pose.translation_m).cross(by_position);
            }
        }
    }
}

/// Gradient by position of `raw` times the interpolated density plus `row` times the interpolated features.
fn slope(level: &Lattice, p: Vec3, raw: f32, row: Option<&[f32]>) -> Vec3 {
    let Some(corners) = level.corners(p) else {
        return Vec3::ZERO;
    };
    let values = corners.nodes.map(|node| {
        let features = &level.features()[node as usize];
        let colored = row.map_or(0.0, |row| {
            features.iter().zip(row).map(|(f, g)| f * g).sum()
        });
        raw * level.density()[node as usize] + colored
    });
    // Along an axis, the weights of a pair of corners sum to the product of the two other axes' fractions.
    let along = |axis: usize| {
        let step = 1 << axis;
        let lower = (0..8).filter(|corner| corner & step == 0);
        let parts = lower.map(|low| {
            let high = low | step;
            (corners.weights[low] + corners.weights[high]) * (values[high] - values[low])
        });
        parts.sum::<f32>()
    };
    Vec3::new(along(0), along(1), along(2)) / level.voxel_m()
}
