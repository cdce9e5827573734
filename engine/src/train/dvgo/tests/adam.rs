//! The optimiser's rules, on points placed at nodes by hand.

use glam::{DVec3, UVec3, Vec3};

use crate::backend::cpu::{NO_SLOT, Simd};
use crate::train::dvgo::adam::GridAdam;
use crate::train::dvgo::chunk::{Chunk, Point};
use crate::train::dvgo::grid::Shape;

const RATE: f64 = 0.1;

fn shape() -> Shape {
    Shape::new(UVec3::splat(20), (DVec3::ZERO, DVec3::ONE))
}

/// A chunk with one density gradient at each of some nodes, and the colour gradient `color`, if any, too.
fn chunk(shape: &Shape, gradients: &[(UVec3, f32)], color: Option<[f32; 4]>) -> Chunk<4> {
    let mut chunk = Chunk::default();
    for (node, raw) in gradients {
        let slot = color.map_or(NO_SLOT, |_| chunk.color_gradients.len() as u32);
        chunk.color_gradients.extend(color);
        chunk.points.push(Point {
            q: node.as_vec3(),
            raw: *raw,
            slot,
        });
    }
    chunk.find_bricks(shape);
    chunk
}

struct Run {
    shape: Shape,
    adam: GridAdam<4>,
    density: Vec<f32>,
    colors: Vec<[f32; 4]>,
}

impl Run {
    fn new(masked: bool, shares: Vec<f32>) -> Self {
        let shape = shape();
        Self {
            adam: GridAdam::new(&shape, masked, shares),
            density: vec![0.0; shape.len()],
            colors: vec![[0.0; 4]; shape.len()],
            shape,
        }
    }

    fn step(&mut self, gradients: &[(UVec3, f32)], color: Option<[f32; 4]>) {
        let chunks = [chunk(&self.shape, gradients, color)];
        let values = (self.density.as_mut_slice(), self.colors.as_mut_slice());
        self.adam
            .step(&self.shape, values, &chunks, (RATE, RATE), Simd::detect());
    }

    fn density(&self, node: UVec3) -> f64 {
        f64::from(self.density[self.shape.at(node)])
    }
}

/// Adam on one value as the books have it, with eps outside the correction as the recipe has it.
fn reference(gradients: &[f64], masked: bool) -> f64 {
    let (mut x, mut m, mut v) = (0.0, 0.0, 0.0);
    for (number, g) in gradients.iter().enumerate() {
        if masked && *g == 0.0 {
            continue;
        }
        m = 0.9 * m + 0.1 * g;
        v = 0.99 * v + 0.01 * g * g;
        let step = number as i32 + 1;
        let correction = (1.0 - 0.99f64.powi(step)).sqrt() / (1.0 - 0.9f64.powi(step));
        x -= RATE * correction * m / (v.sqrt() + 1e-8);
    }
    x
}

const A: UVec3 = UVec3::new(7, 8, 15);
const B: UVec3 = UVec3::new(3, 2, 1);

/// Steps with gradients at A, nothing at all, and at B.
fn three_steps(masked: bool) -> (f64, f64) {
    let mut run = Run::new(masked, Vec::new());
    run.step(&[(A, 2e-6)], None);
    run.step(&[], None);
    run.step(&[(B, -3e-6)], None);
    (run.density(A), run.density(B))
}

#[test]
fn masked_values_rest_without_gradient_and_count_all_steps() {
    let (a, b) = three_steps(true);
    assert!((a - reference(&[2e-6], true)).abs() < 1e-6, "{a}");
    assert!(
        (b - reference(&[0.0, 0.0, -3e-6], true)).abs() < 1e-6,
        "{b}"
    );
    // A count of its own steps would have moved B as A, the other way.
    assert!((b + a).abs() > 1e-2, "{a} {b}");
}

#[test]
fn unmasked_values_go_on_by_momentum() {
    let (a, b) = three_steps(false);
    assert!(
        (a - reference(&[2e-6, 0.0, 0.0], false)).abs() < 1e-6,
        "{a}"
    );
    assert!(
        (b - reference(&[0.0, 0.0, -3e-6], false)).abs() < 1e-6,
        "{b}"
    );
    assert!((a - three_steps(true).0).abs() > 1e-2);
}

#[test]
fn a_brick_at_rest_catches_up() {
    let mut run = Run::new(false, Vec::new());
    let mut gradients = vec![0.0; 450];
    for at in [0, 1, 40, 400, 449] {
        gradients[at] = 1e-6 * (at as f64 + 1.0);
    }
    for g in &gradients {
        let here = [(A, *g as f32)];
        run.step(if *g == 0.0 { &[] } else { &here }, None);
    }
    let (a, exact) = (run.density(A), reference(&gradients, false));
    assert!((a - exact).abs() < 1e-5, "{a} {exact}");
    let mut masked = Run::new(true, Vec::new());
    gradients.iter().for_each(|g| {
        let here = [(A, *g as f32)];
        masked.step(if *g == 0.0 { &[] } else { &here }, None);
    });
    assert!((masked.density(A) - exact).abs() > 1e-3);
}

#[test]
fn shares_scale_the_density_s_rate_and_only_that() {
    let shape = shape();
    let mut shares = vec![1.0; shape.len()];
    shares[shape.at(A)] = 0.25;
    let mut run = Run::new(false, shares);
    let color = [1e-6, -2e-6, 3e-6, 0.0];
    run.step(&[(A, 2e-6), (B, 2e-6)], Some(color));
    assert!((run.density(A) - 0.25 * run.density(B)).abs() < 1e-6);
    let (a, b) = (run.colors[shape.at(A)], run.colors[shape.at(B)]);
    assert_eq!(a, b);
    for c in 0..3 {
        let exact = reference(&[f64::from(color[c])], false);
        assert!((f64::from(a[c]) - exact).abs() < 1e-6, "{a:?}");
    }
}

#[test]
fn a_point_s_gradient_goes_to_its_eight_nodes_across_bricks() {
    let shape = shape();
    let mut chunk = Chunk::<4>::default();
    let q = Vec3::new(7.25, 7.5, 15.75);
    chunk.points.push(Point {
        q,
        raw: 1.0,
        slot: NO_SLOT,
    });
    chunk.find_bricks(&shape);
    assert_eq!(chunk.touched.len(), 8, "the cell's corners are in 8 bricks");
    let mut run = Run::new(true, Vec::new());
    let values = (run.density.as_mut_slice(), run.colors.as_mut_slice());
    run.adam
        .step(&shape, values, &[chunk], (RATE, RATE), Simd::detect());
    let moved = run.density.iter().filter(|x| **x != 0.0).count();
    assert_eq!(moved, 8);
    // Adam's first step is the rate for any gradient, so all eight moved alike.
    let corner = run.density(UVec3::new(8, 8, 16));
    assert!((corner + RATE).abs() < 1e-4, "{corner}");
}
