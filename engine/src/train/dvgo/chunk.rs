//! Forward and backward of a chunk of rays, in blocks whose activations stay in the second-level cache.

#[cfg(all(test, feature = "gpu"))]
pub(crate) mod record;

use glam::{UVec3, Vec3};

use super::grid::Shape;
use super::losses::{LossSetting, RayColors, differentiate_ray};
use super::march::{Medium, Sample};
use super::pixels::PixelRay;
use crate::backend::cpu::bf16::Bf16Batch;
use crate::backend::cpu::colorist::Colorist;
use crate::backend::cpu::lanes::Lanes;
use crate::backend::cpu::mlp::{MlpBatch, PADDED_FEATURES};
use crate::backend::cpu::simd::dispatch;
use crate::backend::cpu::{NO_SLOT, Simd};
use crate::field::activation::sigmoid;
use crate::field::encode_view;
use crate::field::mlp::MLP_OUTPUTS;
use crate::field::transcendental::exp_m1;

/// Rays of a chunk: the unit of scheduling, and of the network's gradient sums, whose order is thus always the same.
pub(super) const RAYS_PER_CHUNK: usize = 256;
/// Rays of a block.
const RAYS_PER_BLOCK: usize = 32;

/// Slots between the one whose colour values are asked for and the one that is interpolated.
const AHEAD: usize = 6;
/// The gradient at one sample.
#[derive(Clone, Copy, Debug)]
pub(super) struct Point {
    /// Node coordinates.
    pub(super) q: Vec3,
    /// By the raw density.
    pub(super) raw: f32,
    /// Row of the chunk's colour gradients, or [`NO_SLOT`].
    pub(super) slot: u32,
}

/// What a chunk found out.
#[derive(Clone, Debug, Default)]
pub(super) struct Chunk<const C: usize> {
    pub(super) points: Vec<Point>,
    pub(super) color_gradients: Vec<[f32; C]>,
    pub(super) network_gradients: Vec<f32>,
    /// (brick, point) for every brick that a point's interpolation reads.
    pub(super) touched: Vec<(u32, u32)>,
    pub(super) squared_error: f64,
    pub(super) loss: f64,
}

/// How colour values become colours: on their own, or with the view by a network.
#[derive(Clone, Copy, Debug)]
pub(super) enum Coloring<'a> {
    Direct,
    Network(&'a Colorist),
}

/// What a chunk reads.
#[derive(Clone, Copy, Debug)]
pub(super) struct Setting<'a, const C: usize> {
    pub(super) medium: Medium<'a>,
    pub(super) colors: &'a [[f32; C]],
    pub(super) coloring: Coloring<'a>,
    pub(super) losses: LossSetting,
    /// Lighter samples are not coloured.
    pub(super) weight_min: f32,
    pub(super) simd: Simd,
}

/// Buffers of one block, one set for each thread.
#[derive(Clone, Debug, Default)]
pub(super) struct Scratch {
    samples: Vec<Sample>,
    ray_ends: Vec<u32>,
    weights: Vec<f32>,
    shown: Vec<bool>,
    /// The samples that are shown: one slot each.
    picked: Vec<u32>,
    /// End of each ray's slots.
    slot_ends: Vec<u32>,
    light_left: Vec<f32>,
    weight_gradients: Vec<f32>,
    tau_gradients: Vec<f32>,
    /// Features or direct colours of the slots.
    batch: MlpBatch,
    bf16: Bf16Batch,
}

impl<const C: usize> Chunk<C> {
    /// Computes all gradients of `rays`.
    pub(super) fn run(
        &mut self,
        setting: &Setting<'_, C>,
        rays: &[PixelRay],
        scratch: &mut Scratch,
    ) {
        self.points.clear();
        self.color_gradients.clear();
        self.touched.clear();
        self.network_gradients.fill(0.0);
        (self.squared_error, self.loss) = (0.0, 0.0);
        std::mem::swap(
            &mut self.network_gradients,
            &mut scratch.batch.parameter_gradients,
        );
        for rays in rays.chunks(RAYS_PER_BLOCK) {
            forward(setting.simd, scratch, setting, rays);
            scratch.color(setting, rays);
            differentiate(setting.simd, scratch, setting, rays, self);
            scratch.add_points(setting, self);
        }
        std::mem::swap(
            &mut self.network_gradients,
            &mut scratch.batch.parameter_gradients,
        );
        self.find_bricks(setting.medium.shape);
    }

    pub(super) fn find_bricks(&mut self, shape: &Shape) {
        for (number, point) in self.points.iter().enumerate() {
            let base = point.q.as_uvec3().min(shape.nodes - 2);
            let (first, last) = (base >> 3u32, (base + 1) >> 3u32);
            if first == last {
                self.touched
                    .push((brick_number(shape, first), number as u32));
                continue;
            }
            for z in first.z..=last.z {
                for y in first.y..=last.y {
                    for x in first.x..=last.x {
                        let brick = brick_number(shape, UVec3::new(x, y, z));
                        self.touched.push((brick, number as u32));
                    }
                }
            }
        }
    }
}

fn brick_number(shape: &Shape, at: UVec3) -> u32 {
    (at.z * shape.bricks.y + at.y) * shape.bricks.x + at.x
}

impl Scratch {
    /// Weights of all samples, and which are shown.
    #[inline(always)]
    fn weigh(&mut self, weight_min: f32) {
        self.weights.clear();
        self.shown.clear();
        self.picked.clear();
        self.slot_ends.clear();
        self.light_left.clear();
        let mut start = 0;
        for end in &self.ray_ends {
            let mut light = 1.0;
            let samples = self.samples[..*end as usize].iter().enumerate();
            for (number, sample) in samples.skip(start) {
                let weight = light * -exp_m1(-sample.tau);
                light -= weight;
                let shown = weight > weight_min;
                if shown {
                    self.picked.push(number as u32);
                }
                self.weights.push(weight);
                self.shown.push(shown);
            }
            start = *end as usize;
            self.light_left.push(light.max(0.0));
            self.slot_ends.push(self.picked.len() as u32);
        }
    }

    /// Colours of all slots.
    fn color<const C: usize>(&mut self, setting: &Setting<'_, C>, rays: &[PixelRay]) {
        let batch = &mut self.batch;
        match setting.coloring {
            Coloring::Direct => {
                batch.colors.clear();
                let colors = batch.features.iter().map(|x| sigmoid(*x));
                batch.colors.extend(colors);
            }
            Coloring::Network(colorist) => {
                batch.views.clear();
                batch.ray_ends.clear();
                let mut before = 0;
                for (ray, end) in rays.iter().zip(&self.slot_ends) {
                    if *end > before {
                        batch
                            .views
                            .extend_from_slice(&encode_view(ray.ray.direction));
                        batch.ray_ends.push(*end);
                    }
                    before = *end;
                }
                colorist.forward(batch, &mut self.bf16);
            }
        }
    }

    /// Sums of squared errors and of losses; gradients by optical depths and by colours.
    #[inline(always)]
    fn differentiate<const C: usize>(
        &mut self,
        setting: &Setting<'_, C>,
        rays: &[PixelRay],
    ) -> (f64, f64) {
        let count = self.samples.len();
        self.weight_gradients.resize(count, 0.0);
        self.tau_gradients.clear();
        self.tau_gradients.resize(count, 0.0);
        let gradients = &mut self.batch.color_gradients;
        gradients.resize(self.batch.colors.len(), 0.0);
        let (mut squared_error, mut loss) = (0.0, 0.0);
        let (mut start, mut first_slot) = (0, 0);
        for (number, ray) in rays.iter().enumerate() {
            let range = start..self.ray_ends[number] as usize;
            let slots = first_slot..self.slot_ends[number] as usize;
            (start, first_slot) = (range.end, slots.end);
            let colors = RayColors {
                slots,
                colors: &self.batch.colors,
                gradients,
                stride: MLP_OUTPUTS,
            };
            let one = differentiate_ray(
                &setting.losses,
                ray.color,
                (
                    &self.weights[range.clone()],
                    &self.shown[range.clone()],
                    self.light_left[number],
                ),
                colors,
                &mut self.weight_gradients[range.clone()],
                &mut self.tau_gradients[range],
            );
            squared_error += f64::from(one.squared_error);
            loss += f64::from(one.loss);
        }
        (squared_error, loss)
    }

    /// Turns the colours' gradients into those of their values, and hands all gradients to the chunk.
    fn add_points<const C: usize>(&mut self, setting: &Setting<'_, C>, chunk: &mut Chunk<C>) {
        let mut slot = chunk.color_gradients.len() as u32;
        let samples = self.samples.iter().zip(&self.tau_gradients);
        for ((sample, gradient), shown) in samples.zip(&self.shown) {
            let raw = gradient * sample.slope;
            if *shown || raw != 0.0 {
                chunk.points.push(Point {
                    q: sample.q,
                    raw,
                    slot: if *shown { slot } else { NO_SLOT },
                });
                slot += u32::from(*shown);
            }
        }
        let batch = &mut self.batch;
        let slots = self.picked.len();
        match setting.coloring {
            Coloring::Direct => {
                let pairs = batch.color_gradients.iter_mut().zip(&batch.colors);
                pairs.for_each(|(g, c)| *g *= c * (1.0 - c));
                let rows = batch.color_gradients.chunks_exact(MLP_OUTPUTS).take(slots);
                chunk.color_gradients.extend(rows.map(|row| {
                    // The fourth value is padding and has no gradient.
                    std::array::from_fn(|c| if c < 3 { row[c] } else { 0.0 })
                }));
            }
            Coloring::Network(colorist) => {
                colorist.backward(batch, &mut self.bf16);
                let rows = batch.feature_gradients.chunks_exact(PADDED_FEATURES);
                chunk
                    .color_gradients
                    .extend(rows.take(slots).map(|row| std::array::from_fn(|c| row[c])));
            }
        }
    }
}

dispatch!(fn forward<const C> => forward_generic(
    scratch: &mut Scratch,
    setting: &Setting<'_, C>,
    rays: &[PixelRay],
));
dispatch!(fn differentiate<const C> => differentiate_generic(
    scratch: &mut Scratch,
    setting: &Setting<'_, C>,
    rays: &[PixelRay],
    chunk: &mut Chunk<C>,
));

/// Samples, weights and interpolated colour values.
#[inline(always)]
fn forward_generic<L: Lanes, const R: usize, const V: usize, const C: usize>(
    scratch: &mut Scratch,
    setting: &Setting<'_, C>,
    rays: &[PixelRay],
) {
    scratch.samples.clear();
    scratch.ray_ends.clear();
    for ray in rays {
        let samples = &mut scratch.samples;
        setting.medium.march(ray.ray, ray.near_m, samples);
        scratch.ray_ends.push(samples.len() as u32);
    }
    scratch.weigh(setting.weight_min);
    scratch.gather(setting);
}

#[inline(always)]
fn differentiate_generic<L: Lanes, const R: usize, const V: usize, const C: usize>(
    scratch: &mut Scratch,
    setting: &Setting<'_, C>,
    rays: &[PixelRay],
    chunk: &mut Chunk<C>,
) {
    let (squared_error, loss) = scratch.differentiate(setting, rays);
    chunk.squared_error += squared_error;
    chunk.loss += loss;
}

impl Scratch {
    /// Interpolates the colour values of all slots.
    #[inline(always)]
    fn gather<const C: usize>(&mut self, setting: &Setting<'_, C>) {
        let slots = self.picked.len();
        let stride = row_len::<C>();
        let rows = &mut self.batch.features;
        rows.resize(slots * stride, 0.0);
        let shape = setting.medium.shape;
        let cell = |slot: usize| {
            let sample = self.picked.get(slot).unwrap_or(&0);
            shape.cell(self.samples[*sample as usize].q)
        };
        for (slot, row) in rows.chunks_exact_mut(stride).enumerate() {
            cell(slot + AHEAD).prefetch_rows(setting.colors);
            row[..C].copy_from_slice(&cell(slot).interpolate_rows(setting.colors));
            row[C..].fill(0.0);
        }
    }
}

/// Values per row of the batch: a network's features are padded to whole vectors, direct colours are whole already.
#[inline(always)]
fn row_len<const C: usize>() -> usize {
    if C > MLP_OUTPUTS { PADDED_FEATURES } else { C }
}
