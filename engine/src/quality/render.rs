//! Renders rays of a single field, for measuring it.

use glam::Vec3;
use rayon::prelude::*;

use crate::field::{ColorScratch, Field, Ray, RaySample};
use crate::volume;

/// Rays rendered together by one thread.
const RAYS_PER_CHUNK: usize = 256;
/// A ray ends at this optical depth.
const STOP_TAU: f32 = 6.9;
/// Samples lighter than this are not coloured.
const MIN_WEIGHT: f32 = 1e-4;

/// What one ray shows.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RenderedRay {
    /// sRGB in 0..1, composited over the field's sky.
    pub color: [f32; 3],
    /// 0..1.
    pub accumulation: f32,
    /// Expected Euclidean distance in metres of what was hit, i.e. divided by the accumulation; 0 if nothing was.
    pub range_m: f32,
}

/// Renders every ray of a field.
pub fn render_rays(field: &Field, rays: &[Ray]) -> Vec<RenderedRay> {
    render_counted(field, rays).0
}

/// [`render_rays`], and how many samples were coloured.
#[doc(hidden)]
pub fn render_counted(field: &Field, rays: &[Ray]) -> (Vec<RenderedRay>, usize) {
    let mut rendered = vec![RenderedRay::default(); rays.len()];
    let colored = rendered
        .par_chunks_mut(RAYS_PER_CHUNK)
        .zip(rays.par_chunks(RAYS_PER_CHUNK))
        .map_init(Scratch::default, |scratch, (out, rays)| {
            scratch.render(field, rays, out);
            scratch.positions.len()
        })
        .sum();
    (rendered, colored)
}

#[derive(Default)]
struct Scratch {
    samples: Vec<RaySample>,
    weights: Vec<f32>,
    positions: Vec<Vec3>,
    directions: Vec<Vec3>,
    /// Ray and weight of every position.
    shares: Vec<(usize, f32)>,
    colors: Vec<[f32; 3]>,
    color: ColorScratch,
}

impl Scratch {
    fn render(&mut self, field: &Field, rays: &[Ray], out: &mut [RenderedRay]) {
        self.positions.clear();
        self.directions.clear();
        self.shares.clear();
        for (number, (ray, out)) in rays.iter().zip(out.iter_mut()).enumerate() {
            self.samples.clear();
            field.march(
                ray.origin,
                ray.direction,
                0.0,
                f32::INFINITY,
                STOP_TAU,
                &mut self.samples,
            );
            self.weights.clear();
            self.weights.resize(self.samples.len(), 0.0);
            let end = volume::weights(&self.samples, &mut self.weights).transmittance;
            *out = RenderedRay {
                color: field.sky(ray.direction).map(|c| c * end),
                accumulation: 1.0 - end,
                range_m: 0.0,
            };
            for (sample, weight) in self.samples.iter().zip(&self.weights) {
                out.range_m += weight * sample.t;
                if *weight > MIN_WEIGHT {
                    self.positions.push(ray.at(sample.t));
                    self.directions.push(ray.direction);
                    self.shares.push((number, *weight));
                }
            }
            if out.accumulation > 0.0 {
                out.range_m /= out.accumulation;
            }
        }
        field.colors(
            &self.positions,
            &self.directions,
            &mut self.colors,
            &mut self.color,
        );
        for ((ray, weight), color) in self.shares.iter().zip(&self.colors) {
            (0..3).for_each(|c| out[*ray].color[c] += weight * color[c]);
        }
    }
}
