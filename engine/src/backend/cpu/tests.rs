//! The whole renderer's gradients against f64 differences of a plain forward pass, and what one step does with them.

use glam::Vec3;

use super::chunk::{Chunk, NO_SLOT, Setting};
use super::mlp::{PADDED_FEATURES, TransposedWeights};
use super::*;
use crate::field::lattice::BRICK_NODES;
use crate::field::mlp::{MLP_INPUTS, MLP_OUTPUTS};
use crate::field::{
    ColorMlp, DensityActivation, FEATURES, Lattice, MarchRange, Occupancy, Ray, RaySample, SkyGrid,
    SkyMap, encode_view,
};
use crate::scene::Draws;
use crate::train::ray::{Backdrop, DepthForm, Rates, RayLosses, Rectified, Silhouette, TrainRay};

/// f32 gradients through 39 + 16 + 16 terms and up to 40 samples; measured near 1e-5.
const TOLERANCE: f64 = 1e-3;
const H: f64 = 1e-4;
const LOSSES: RayLosses = RayLosses {
    sample_color: 0.1,
    entropy: 0.02,
    depth_scale_m: 0.05,
    depth_cap_m: 1.0,
    min_weight: 0.0,
    depth_trim_m: f32::INFINITY,
    depth: DepthForm::Expected,
    rectified: Rectified::CrossEntropy,
    distortion: 0.0,
    distortion_scale_m: 1.0,
    density_variation: 0.0,
    feature_variation: 0.0,
    exposure_prior: 0.0,
    pose_prior: 0.0,
};

fn field() -> Field {
    let mut draws = Draws::new(5, 0, 0);
    let (low, high) = (Vec3::splat(-1.0), Vec3::splat(1.0));
    let mut levels = Vec::new();
    for voxel_m in [0.25, 0.125] {
        let mut level = Lattice::new(voxel_m, low, high - low).unwrap();
        for number in 0..level.bricks_per_axis().element_product() as u16 {
            let side = level.bricks_per_axis().x as u16;
            // The finer level stores half its bricks, so that missing ones are met.
            if voxel_m > 0.2 || number % 2 == 0 {
                level.allocate([number % side, number / side % side, number / (side * side)]);
            }
        }
        let (density, features) = level.parameters_mut();
        density[BRICK_NODES..]
            .iter_mut()
            .for_each(|d| *d = draws.uniform(-1.0, 1.5) as f32);
        for node in &mut features[BRICK_NODES..] {
            *node = std::array::from_fn(|_| draws.jitter(1.0) as f32);
        }
        levels.push(level);
    }
    let mut sky = SkyGrid::new(16, 8);
    sky.logits_mut()
        .iter_mut()
        .for_each(|l| *l = std::array::from_fn(|_| draws.jitter(1.0) as f32));
    let mut occupancy = Occupancy::new(0.25, low, high - low).unwrap();
    occupancy.set_block(glam::UVec3::ZERO, [u64::MAX; 8], 0.06);
    Field {
        bounds_m: (low, high),
        levels,
        activation: DensityActivation::from_alpha(0.1, 0.1),
        mlp: ColorMlp::new(16, || draws.unit()),
        sky: Some(SkyMap::new(vec![sky])),
        occupancy,
        step_growth: 0.0,
    }
}

fn rays() -> Vec<TrainRay> {
    let mut draws = Draws::new(6, 0, 0);
    (0..6)
        .map(|number| {
            let origin = Vec3::new(-2.0, draws.jitter(0.5) as f32, draws.jitter(0.5) as f32);
            let target = Vec3::new(0.5, draws.jitter(0.5) as f32, draws.jitter(0.5) as f32);
            TrainRay {
                ray: Ray {
                    origin,
                    direction: (target - origin).normalize_or_zero(),
                },
                phase: 0.5,
                t_max: f32::INFINITY,
                color: std::array::from_fn(|_| draws.unit() as f32),
                color_weight: if number == 5 { 0.0 } else { 0.2 },
                backdrop: if number == 1 {
                    Backdrop::Color([0.1, 0.9, 0.3])
                } else {
                    Backdrop::Sky
                },
                silhouette: [
                    Silhouette::Unknown,
                    Silhouette::Opaque,
                    Silhouette::Transparent,
                ][number % 3],
                silhouette_weight: 0.05,
                range_m: 2.3,
                range_weight: if number >= 4 { 0.1 } else { 0.0 },
                view: number as u32,
                mirrored: false,
            }
        })
        .collect()
}

/// All parameters of the field in one vector of f64: densities, features, network, sky.
fn parameters(field: &Field) -> Vec<f64> {
    let mut all = Vec::new();
    for level in &field.levels {
        all.extend(level.density().iter().map(|x| f64::from(*x)));
        all.extend(level.features().iter().flatten().map(|x| f64::from(*x)));
    }
    all.extend(field.mlp.parameters().iter().map(|x| f64::from(*x)));
    let sky = field.sky.as_ref().unwrap();
    all.extend(
        sky.grids()[0]
            .logits()
            .iter()
            .flatten()
            .map(|x| f64::from(*x)),
    );
    all
}

/// Where each level's densities and features start, then network and sky.
fn offsets(field: &Field) -> (Vec<(usize, usize)>, usize, usize) {
    let mut at = 0;
    let mut levels = Vec::new();
    for level in &field.levels {
        let nodes = level.density().len();
        levels.push((at, at + nodes));
        at += nodes * (1 + FEATURES);
    }
    (levels, at, at + field.mlp.parameters().len())
}

/// The loss, in f64 and straight from the formulas. Sample points are those of the f32 march, which no parameter moves.
fn loss(field: &Field, rays: &[TrainRay], samples: &[Vec<RaySample>], p: &[f64]) -> f64 {
    let sigmoid = |x: f64| 1.0 / (1.0 + (-x).exp());
    let (levels, mlp_at, sky_at) = offsets(field);
    let layout = field.mlp.layout();
    let affine = |w: std::ops::Range<usize>, b: std::ops::Range<usize>, x: &[f64]| -> Vec<f64> {
        let out = b.len();
        (0..out)
            .map(|o| {
                p[mlp_at + b.start + o]
                    + (0..x.len())
                        .map(|i| x[i] * p[mlp_at + w.start + i * out + o])
                        .sum::<f64>()
            })
            .collect()
    };
    let mut total = 0.0;
    for (ray, samples) in rays.iter().zip(samples) {
        let view = encode_view(ray.ray.direction);
        let (mut transmittance, mut tau_sum) = (1.0, 0.0);
        let (mut color, mut own, mut range) = ([0.0; 3], 0.0, 0.0);
        for sample in samples {
            let position = ray.ray.at(sample.t);
            let (mut raw, mut input) = (0.0, vec![0.0; MLP_INPUTS]);
            for (level, (density_at, features_at)) in field.levels.iter().zip(&levels) {
                let Some(corners) = level.corners(position) else {
                    continue;
                };
                for (node, weight) in corners.nodes.iter().zip(corners.weights) {
                    let (node, weight) = (*node as usize, f64::from(weight));
                    raw += weight * p[density_at + node];
                    (0..FEATURES)
                        .for_each(|f| input[f] += weight * p[features_at + node * FEATURES + f]);
                }
            }
            let sigma = (raw + f64::from(field.activation.act_shift)).exp().ln_1p()
                / f64::from(field.activation.base_voxel_m);
            let tau = sigma * f64::from(sample.dt);
            let weight = transmittance * (1.0 - (-tau).exp());
            transmittance *= (-tau).exp();
            tau_sum += tau;
            let error = (f64::from(sample.t) - f64::from(ray.range_m)).abs();
            let scale = f64::from(LOSSES.depth_scale_m);
            let huber = if error < scale {
                error * error / (2.0 * scale)
            } else {
                error - scale / 2.0
            };
            range += weight * huber.min(f64::from(LOSSES.depth_cap_m));
            if ray.color_weight > 0.0 {
                (0..view.len()).for_each(|i| input[FEATURES + i] = f64::from(view[i]));
                let relu = |x: Vec<f64>| x.into_iter().map(|x| x.max(0.0)).collect::<Vec<_>>();
                let hidden = relu(affine(layout.w1(), layout.b1(), &input));
                let hidden = relu(affine(layout.w2(), layout.b2(), &hidden));
                let out = affine(layout.w3(), layout.b3(), &hidden);
                for c in 0..3 {
                    let value = sigmoid(out[c]);
                    color[c] += weight * value;
                    // The weight of the per-sample loss is held constant: taken from the f32 forward pass.
                    own += held_weight(samples, sample) * (value - f64::from(ray.color[c])).powi(2);
                }
            }
        }
        if ray.color_weight > 0.0 {
            let texels = field.sky.as_ref().unwrap().grids()[0].texels(ray.ray.direction);
            for c in 0..3 {
                let logit: f64 = (0..4)
                    .map(|i| {
                        f64::from(texels.weights[i]) * p[sky_at + texels.texels[i] as usize * 3 + c]
                    })
                    .sum();
                color[c] += transmittance
                    * match ray.backdrop {
                        Backdrop::Sky | Backdrop::SkyAsIs => sigmoid(logit),
                        Backdrop::Color(color) => f64::from(color[c]),
                    };
            }
            let squares: f64 = (0..3)
                .map(|c| (color[c] - f64::from(ray.color[c])).powi(2))
                .sum();
            let entropy = -(transmittance * transmittance.ln()
                + (1.0 - transmittance) * (1.0 - transmittance).ln());
            total += f64::from(ray.color_weight)
                * (squares / 3.0
                    + f64::from(LOSSES.sample_color) * own
                    + f64::from(LOSSES.entropy) * entropy);
        }
        if ray.range_weight > 0.0 {
            total += f64::from(ray.range_weight)
                * (range + transmittance * f64::from(LOSSES.depth_cap_m));
        }
        total += f64::from(ray.silhouette_weight)
            * match ray.silhouette {
                Silhouette::Unknown => 0.0,
                Silhouette::Opaque => -(1.0 - (-tau_sum).exp()).ln(),
                Silhouette::Transparent => tau_sum,
            };
    }
    total
}

fn held_weight(samples: &[RaySample], of: &RaySample) -> f64 {
    let before: f64 = samples
        .iter()
        .take_while(|s| s.t < of.t)
        .map(|s| f64::from(s.sigma * s.dt))
        .sum();
    (-before).exp() * (1.0 - (-f64::from(of.sigma * of.dt)).exp())
}

fn run(field: &Field, rays: &[TrainRay], simd: Simd) -> Chunk {
    let transposed = TransposedWeights::new(&field.mlp);
    let mut chunk = Chunk::default();
    let setting = Setting {
        field,
        transposed: &transposed,
        losses: &LOSSES,
        simd,
    };
    chunk.run(setting, rays);
    chunk
}

/// The chunk's gradients by all parameters, spread over nodes in the plainest way.
fn dense_gradient(field: &Field, chunk: &Chunk) -> Vec<f64> {
    let (levels, mlp_at, sky_at) = offsets(field);
    let mut out = vec![0.0; parameters(field).len()];
    for (level, (density_at, features_at)) in field.levels.iter().zip(&levels) {
        for point in &chunk.points {
            let Some(corners) = level.corners(point.position) else {
                continue;
            };
            for (node, weight) in corners.nodes.iter().zip(corners.weights) {
                let (node, weight) = (*node as usize, f64::from(weight));
                out[density_at + node] += weight * f64::from(point.raw);
                if point.slot != NO_SLOT {
                    let row = point.slot as usize * PADDED_FEATURES;
                    for f in 0..FEATURES {
                        let gradient = chunk.batch.feature_gradients[row + f];
                        out[features_at + node * FEATURES + f] += weight * f64::from(gradient);
                    }
                }
            }
        }
    }
    for (i, g) in chunk.batch.parameter_gradients.iter().enumerate() {
        out[mlp_at + i] = f64::from(*g);
    }
    for texel in &chunk.sky {
        (0..3)
            .for_each(|c| out[sky_at + texel.texel as usize * 3 + c] += f64::from(texel.logits[c]));
    }
    out
}

/// Largest error of `gradient` against differences, relative to the largest difference of the same kind of parameter.
fn worst_error(field: &Field, rays: &[TrainRay], gradient: &[f64]) -> f64 {
    let samples: Vec<Vec<RaySample>> = rays
        .iter()
        .map(|ray| {
            let mut out = Vec::new();
            let range = MarchRange {
                t_min: 0.0,
                t_max: ray.t_max,
                stop_tau: 6.9,
                phase: ray.phase,
            };
            field.march_ray(ray.ray, range, &mut out);
            out
        })
        .collect();
    let p = parameters(field);
    let (levels, mlp_at, sky_at) = offsets(field);
    let mut bounds = vec![0];
    levels.iter().for_each(|(d, f)| bounds.extend([*d, *f]));
    bounds.extend([mlp_at, sky_at, p.len()]);
    let mut draws = Draws::new(8, 0, 0);
    let mut worst: f64 = 0.0;
    for kind in bounds.windows(2).filter(|w| w[1] > w[0]) {
        let mut moved: Vec<usize> = (kind[0]..kind[1]).filter(|i| gradient[*i] != 0.0).collect();
        if kind[0] == mlp_at {
            // The padded fourth output moves no loss.
            let padded = |i: usize| {
                let layout = field.mlp.layout();
                i - mlp_at >= layout.w3().start
                    && (i - mlp_at - layout.w3().start) % MLP_OUTPUTS == 3
            };
            moved.retain(|i| !padded(*i));
        }
        assert!(!moved.is_empty());
        let chosen: Vec<usize> = (0..24).map(|_| moved[draws.below(moved.len())]).collect();
        let numeric: Vec<f64> = chosen
            .iter()
            .map(|i| {
                let mut p = p.clone();
                p[*i] += H;
                let high = loss(field, rays, &samples, &p);
                p[*i] -= 2.0 * H;
                (high - loss(field, rays, &samples, &p)) / (2.0 * H)
            })
            .collect();
        let scale = numeric.iter().fold(1e-12, |m: f64, x| m.max(x.abs()));
        for (i, n) in chosen.iter().zip(&numeric) {
            worst = worst.max((gradient[*i] - n).abs() / scale);
        }
    }
    worst
}

#[test]
fn the_renderers_gradient_is_right_on_every_path_and_a_broken_one_is_rejected() {
    let (field, rays) = (field(), rays());
    for simd in Simd::available() {
        let mut gradient = dense_gradient(&field, &run(&field, &rays, simd));
        let error = worst_error(&field, &rays, &gradient);
        assert!(error < TOLERANCE, "{simd:?}: relative error {error}");
        // Broken: the gradient by density a tenth too large.
        let (levels, ..) = offsets(&field);
        gradient[levels[0].0..levels[0].1]
            .iter_mut()
            .for_each(|g| *g *= 1.1);
        assert!(worst_error(&field, &rays, &gradient) > 10.0 * TOLERANCE);
    }
}

#[test]
fn a_step_moves_every_node_against_its_summed_gradient() {
    let (field, rays) = (field(), rays());
    let gradient = dense_gradient(&field, &run(&field, &rays, Simd::detect()));
    let before = parameters(&field);
    let (levels, ..) = offsets(&field);
    let mut trainer = CpuTrainer::new(field, Simd::detect());
    let rates = Rates {
        density: 0.01,
        features: 0.01,
        mlp: 0.0,
        sky: 0.0,
        ..Rates::default()
    };
    trainer.step(&rays, &LOSSES, rates);
    let after = parameters(trainer.field());
    let mut checked = 0;
    for (density_at, features_at) in levels {
        // The null brick is shared by all that is missing, and must stay zero.
        assert!(
            after[density_at..density_at + BRICK_NODES]
                .iter()
                .all(|x| *x == 0.0)
        );
        for node in density_at + BRICK_NODES..features_at {
            let (moved, gradient) = (after[node] - before[node], gradient[node]);
            // The first step of RMSProp is the rate times the sign.
            if gradient.abs() > 1e-6 {
                assert!(
                    (moved + 0.01 * gradient.signum()).abs() < 1e-4,
                    "{moved} {gradient}"
                );
                checked += 1;
            } else if gradient == 0.0 {
                assert_eq!(moved, 0.0);
            }
        }
    }
    assert!(checked > 200, "{checked}");
}

#[test]
fn steps_do_not_depend_on_the_number_of_threads() {
    let rays: Vec<TrainRay> = rays().into_iter().cycle().take(400).collect();
    let rates = Rates {
        density: 0.05,
        features: 0.05,
        mlp: 1e-3,
        sky: 0.05,
        ..Rates::default()
    };
    let trained = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        let mut trainer = CpuTrainer::new(field(), Simd::detect());
        pool.install(|| {
            (0..3).for_each(|_| {
                trainer.step(&rays, &LOSSES, rates);
            })
        });
        parameters(trainer.field())
    };
    let one = trained(1);
    assert_eq!(one, trained(3));
    assert_ne!(one, parameters(&field()));
}
