//! The dense grid's kernels by themselves, for the benchmarks only.

use glam::{DVec3, UVec3, Vec3};

use super::adam::GridAdam;
use super::chunk::{Chunk, Point};
use super::grid::Shape;
use crate::backend::cpu::Simd;
use crate::field::FEATURES;
use crate::scene::Draws;

/// A grid with gradients at points along random lines through it, as rays have them.
#[derive(Debug)]
pub struct GridKernels {
    shape: Shape,
    density: Vec<f32>,
    features: Vec<[f32; FEATURES]>,
    adam: GridAdam<FEATURES>,
    chunks: Vec<Chunk<FEATURES>>,
}

/// Points of a chunk, and on a line.
const CHUNK: usize = 4_096;
const LINE: usize = 32;

impl GridKernels {
    /// A cube of `nodes` per axis and `points` points.
    pub fn new(nodes: u32, points: usize) -> Self {
        let shape = Shape::new(UVec3::splat(nodes), (DVec3::ZERO, DVec3::ONE));
        let mut draws = Draws::new(1, 0, 0);
        let mut chunks = vec![Chunk::default(); points.div_ceil(CHUNK)];
        for chunk in &mut chunks {
            for _ in 0..CHUNK / LINE {
                add_line(chunk, nodes, &mut draws);
            }
            chunk.find_bricks(&shape);
        }
        Self {
            density: vec![0.0; shape.len()],
            features: vec![[0.0; FEATURES]; shape.len()],
            adam: GridAdam::new(&shape, true, Vec::new()),
            chunks,
            shape,
        }
    }

    pub fn point_count(&self) -> usize {
        self.chunks.iter().map(|chunk| chunk.points.len()).sum()
    }

    /// Interpolates all points' features one after the other; returns their sum.
    pub fn gather(&self) -> f32 {
        let points = self.chunks.iter().flat_map(|chunk| &chunk.points);
        let features = points.map(|p| self.shape.cell(p.q).interpolate_rows(&self.features));
        features.map(|row| row[0]).sum()
    }

    /// Sorts all points by brick, sums their gradients and moves the values they touch.
    pub fn scatter_and_step(&mut self) {
        let values = (self.density.as_mut_slice(), self.features.as_mut_slice());
        let rates = (0.1, 0.1);
        self.adam
            .step(&self.shape, values, &self.chunks, rates, Simd::detect());
    }
}

fn add_line(chunk: &mut Chunk<FEATURES>, nodes: u32, draws: &mut Draws) {
    let mut draw =
        |low: f64, high: f64| Vec3::from_array([0; 3].map(|_| draws.uniform(low, high) as f32));
    let last = f64::from(nodes - 1);
    let (start, direction) = (draw(0.0, last), draw(-1.0, 1.0).normalize_or(Vec3::X));
    for number in 0..LINE {
        let q = start + direction * 0.5 * number as f32;
        chunk.points.push(Point {
            q: q.clamp(Vec3::ZERO, Vec3::splat(last as f32)),
            raw: 1e-6,
            slot: chunk.color_gradients.len() as u32,
        });
        chunk.color_gradients.push([1e-6; FEATURES]);
    }
}
