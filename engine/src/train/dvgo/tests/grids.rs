//! Grids, masks, sampling, and how stages hand over.

use glam::{DVec3, UVec3, Vec3};

use super::scene::{DISTANCE_M, view, views};
use crate::field::lattice::FEATURES;
use crate::field::{MarchRange, Ray};
use crate::scene::Draws;
use crate::train::dvgo::DvgoRecipe;
use crate::train::dvgo::finish::{cubic_box, field_of};
use crate::train::dvgo::grid::Shape;
use crate::train::dvgo::march::{Medium, Sample, raw_of_alpha};
use crate::train::dvgo::mask::{NodeMask, nearest};
use crate::train::dvgo::network::initial_network;
use crate::train::dvgo::pixels::Pixels;
use crate::train::dvgo::resample::resample;
use crate::train::dvgo::stage::{Stage, resolution};
use crate::train::dvgo::view_count::count_views;
use crate::view::Split;

fn cube(nodes: u32) -> Shape {
    Shape::new(UVec3::splat(nodes), (DVec3::splat(-1.0), DVec3::ONE))
}

fn random(shape: &Shape, draws: &mut Draws) -> Vec<f32> {
    let mut values = vec![0.0; shape.len()];
    shape.for_each_node(|_, at| values[at] = draws.uniform(-2.0, 2.0) as f32);
    values
}

/// The fine stage at the start of a scene in the box, with the recipe's constants.
fn fine(bounds: (DVec3, DVec3), recipe: &DvgoRecipe) -> Stage<FEATURES> {
    let last = recipe.fine_grid.voxels;
    let (base_voxel_m, last_nodes) = resolution(bounds, last);
    let (voxel_m, nodes) = resolution(bounds, last >> recipe.scale_steps.len());
    let shape = Shape::new(nodes, cubic_box(bounds, last_nodes));
    let mask = NodeMask::new(&shape, |_| true);
    let mut draws = Draws::new(1, 0, 0);
    let mlp = initial_network(32, || draws.unit());
    let parts = (recipe.fine_grid, recipe.fine);
    let sizes = (voxel_m, base_voxel_m);
    Stage::new(parts, shape, sizes, mask, Some(mlp), [1.0; 3])
}

#[test]
fn a_finer_grid_is_the_same_function() {
    let mut draws = Draws::new(2, 0, 0);
    let (from, to) = (cube(9), cube(17));
    let values = random(&from, &mut draws);
    let fine = resample(&from, values.as_chunks::<1>().0, &to).into_flattened();
    from.for_each_node(|node, at| {
        assert!((fine[to.at(node * 2)] - values[at]).abs() < 1e-6, "{node}");
    });
    // Between nodes, too: halving a trilinear cell keeps it.
    for _ in 0..100 {
        let q = Vec3::from_array([0; 3].map(|_| draws.uniform(0.0, 8.0) as f32));
        let (a, b) = (from.cell(q), to.cell(q * 2.0));
        assert!((a.interpolate(&values) - b.interpolate(&fine)).abs() < 1e-5);
        assert!((a.interpolate(&values) - from.cell(q * 0.9).interpolate(&values)).abs() > 1e-9);
    }
}

#[test]
fn untouched_space_fades_below_the_threshold_at_the_last_scale() {
    let mut recipe = DvgoRecipe::default();
    // Opacities depend on the ratio of voxels only, and fewer are quicker.
    recipe.fine_grid.voxels = 32 * 32 * 32;
    let bounds = (DVec3::splat(-1.0), DVec3::ONE);
    let mut stage = fine(bounds, &recipe);
    assert!((stage.activation.act_shift + 4.5951).abs() < 1e-3);
    let alpha = |stage: &Stage<FEATURES>| {
        let medium = stage.medium();
        let softplus = f64::from(medium.shift).exp().ln_1p();
        -(-softplus * f64::from(medium.interval)).exp_m1()
    };
    let mut alphas = vec![alpha(&stage)];
    for done in 1..=4 {
        let (voxel_m, nodes) = resolution(bounds, recipe.fine_grid.voxels >> (4 - done));
        stage.rescale(nodes, voxel_m, recipe.shift_per_scale);
        alphas.push(alpha(&stage));
    }
    assert_eq!(stage.shape.nodes, UVec3::splat(32));
    assert!((stage.activation.act_shift + 8.5951).abs() < 1e-3);
    for (alpha, published) in alphas.iter().zip([1.26e-2, 3.7e-3, 1.1e-3, 3.2e-4, 9.2e-5]) {
        assert!((alpha / published - 1.0).abs() < 0.02, "{alphas:?}");
    }
    let threshold = recipe.fine_grid.alpha_min;
    assert!(alphas[3] > threshold && alphas[4] < threshold);
    // Nothing of it is sampled any more.
    let mut samples = Vec::new();
    let ray = Ray {
        origin: Vec3::new(0.1, 0.2, -3.0),
        direction: Vec3::Z,
    };
    stage.medium().march(ray, 0.0, &mut samples);
    assert!(samples.is_empty());
}

#[test]
fn the_coarse_stage_begins_as_published() {
    let recipe = DvgoRecipe::default().coarse_grid;
    let shift = crate::field::DensityActivation::from_alpha(recipe.alpha_init, 1.0).act_shift;
    assert!((shift + 13.8155).abs() < 1e-3, "{shift}");
    let raw = raw_of_alpha(recipe.alpha_init, 1.0, f64::from(shift));
    assert!(raw.abs() < 1e-4, "{raw}");
}

#[test]
fn a_dense_node_keeps_its_26_neighbours_in_the_mask() {
    let shape = cube(20);
    let mut density = vec![-5.0; shape.len()];
    let dense = UVec3::new(8, 7, 19);
    density[shape.at(dense)] = 1.0;
    let mask = NodeMask::dense(&shape, &density, 0.0);
    shape.for_each_node(|node, _| {
        let off = (node.as_ivec3() - dense.as_ivec3()).abs().max_element();
        assert_eq!(mask.near(node.as_vec3()), off <= 1, "{node}");
    });
    let nothing = NodeMask::dense(&shape, &density, 2.0);
    assert!(!nothing.near(dense.as_vec3()));
    assert_eq!(mask.clone().and(&nothing), nothing);
}

#[test]
fn renewing_only_ever_clears() {
    let mut stage = fine((DVec3::splat(-1.0), DVec3::ONE), &DvgoRecipe::default());
    let half = NodeMask::new(&stage.shape, |node| node.x < 30);
    stage.mask = half;
    stage.density.fill(-30.0);
    let lump = stage.shape.at(UVec3::new(29, 20, 20));
    stage.density[lump] = 5.0;
    stage.renew_mask();
    let set = |x: f32, y: f32| stage.mask.near(Vec3::new(x, y, 20.0));
    assert!(set(29.0, 21.0) && set(28.0, 20.0));
    assert!(!set(30.0, 20.0), "was clear before");
    assert!(!set(29.0, 23.0), "has become thin");
}

#[test]
fn skipping_blocks_loses_no_sample() {
    let shape = cube(40);
    let mut draws = Draws::new(4, 0, 0);
    let density = vec![0.0; shape.len()];
    let ball = |node: UVec3| (node.as_vec3() - Vec3::splat(13.0)).length() < 9.5;
    let mask = NodeMask::new(&shape, ball);
    let medium = Medium {
        shape: &shape,
        density: &density,
        mask: &mask,
        shift: -9.0,
        interval: 0.5,
        raw_min: -1.0,
        step_m: 0.5 * shape.spacing_m().x as f32,
    };
    let mut total = 0;
    for _ in 0..300 {
        let point = |draws: &mut Draws, r: f64| {
            Vec3::from_array([0; 3].map(|_| draws.uniform(-r, r) as f32))
        };
        let origin = point(&mut draws, 1.0).normalize() * 3.0;
        let ray = Ray {
            origin,
            direction: (point(&mut draws, 1.0) - origin).normalize(),
        };
        let mut samples: Vec<Sample> = Vec::new();
        medium.march(ray, 2.2, &mut samples);
        assert_eq!(samples.len(), plain_count(&medium, ray, 2.2, ball));
        total += samples.len();
    }
    assert!(total > 1_000, "{total}");
}

/// Samples of a ray, stepping one by one.
fn plain_count(
    medium: &Medium<'_>,
    ray: Ray,
    near_m: f32,
    inside: impl Fn(UVec3) -> bool,
) -> usize {
    let shape = medium.shape;
    let low = shape.low.as_vec3();
    let Some((enter, leave)) = ray.cross_box(low, shape.high.as_vec3()) else {
        return 0;
    };
    let per_m = shape.spacing_m().as_vec3().recip();
    let first = (ray.at(enter.max(near_m)) - low) * per_m;
    let step = ray.direction * medium.step_m * per_m;
    let last = (shape.nodes - 1).as_vec3();
    let count = ((leave - enter.max(near_m)) / medium.step_m)
        .ceil()
        .max(0.0) as u32;
    (0..count)
        .map(|i| first + step * i as f32)
        .filter(|q| q.cmpge(Vec3::ZERO).all() && q.cmple(last).all())
        .filter(|q| inside(nearest(*q)))
        .count()
}

#[test]
fn views_are_counted_where_they_look() {
    let views = [
        view(DVec3::X * DISTANCE_M, 60, Split::Train),
        view(DVec3::Y * DISTANCE_M, 60, Split::Train),
        view(DVec3::NEG_X * DISTANCE_M, 60, Split::HeldOut),
    ];
    let shape = Shape::new(UVec3::splat(25), (DVec3::splat(-3.0), DVec3::splat(3.0)));
    let mask = NodeMask::new(&shape, |_| true);
    let density = vec![0.0; shape.len()];
    let medium = Medium {
        shape: &shape,
        density: &density,
        mask: &mask,
        shift: 0.0,
        interval: 0.5,
        raw_min: 0.0,
        step_m: 0.125,
    };
    let counts = count_views(&Pixels::new(&views, 2.0), &medium);
    let at = |x: u32, y: u32| counts[shape.at(UVec3::new(x, y, 12))];
    assert_eq!(at(12, 12), 2, "the centre");
    assert_eq!(
        at(4, 12),
        1,
        "far behind the centre for one, beside it for the other"
    );
    assert_eq!(at(23, 12), 0, "nearer than the near distance");
    assert_eq!(at(18, 18), 0, "in no view");
}

#[test]
fn the_finished_field_is_the_trained_function() {
    let recipe = DvgoRecipe {
        scale_steps: Vec::new(),
        ..DvgoRecipe::default()
    };
    let mut small = recipe.clone();
    small.fine_grid.voxels = 30 * 30 * 30;
    let bounds = (DVec3::new(-1.0, -0.7, -0.9), DVec3::new(0.8, 0.9, 1.0));
    let mut stage = fine(bounds, &small);
    let spacing = stage.shape.spacing_m();
    assert!((spacing.max_element() - spacing.min_element()).abs() < 1e-12);
    assert!(stage.shape.low.cmple(bounds.0).all() && stage.shape.high.cmpge(bounds.1).all());
    let mut draws = Draws::new(6, 0, 0);
    let shape = stage.shape;
    shape.for_each_node(|node, at| {
        let inside = (node.as_vec3() - Vec3::splat(14.0)).length() < 8.0;
        stage.density[at] = if inside {
            draws.uniform(2.0, 9.0) as f32
        } else {
            -20.0
        };
        stage.colors[at] = [draws.uniform(-1.0, 1.0) as f32; FEATURES];
    });
    stage.renew_mask();
    let field = field_of(&stage);
    for _ in 0..200 {
        let unit = Vec3::from_array([0; 3].map(|_| draws.unit() as f32));
        let q = unit * (shape.nodes - 1).as_vec3() * 0.999;
        let p = shape.low.as_vec3() + q * shape.spacing_m().as_vec3();
        let cell = shape.cell(q);
        let off = field.raw_density(p) - cell.interpolate(&stage.density);
        assert!(off.abs() < 1e-3, "{off}");
        let colors = cell.interpolate_rows(&stage.colors);
        assert!((field.features(p)[3] - colors[3]).abs() < 1e-4);
    }
    // Marched opacities agree but for where in the intervals densities are read.
    let (mut ours, mut theirs) = (Vec::new(), Vec::new());
    for view in views(6, 0, 12) {
        let pixels = [view];
        let rays = Pixels::new(&pixels, 0.0);
        let ray = rays.ray(&pixels[0], 6, 6).ray;
        ours.clear();
        theirs.clear();
        stage.medium().march(ray, 0.0, &mut ours);
        let range = MarchRange {
            t_min: 0.0,
            t_max: f32::INFINITY,
            stop_tau: 1e9,
            phase: 0.5,
        };
        let tau = field.march_ray(ray, range, &mut theirs);
        let expected: f32 = ours.iter().map(|sample| sample.tau).sum();
        assert!(expected > 6.9 && tau >= expected * 0.8, "{tau} {expected}");
    }
}
