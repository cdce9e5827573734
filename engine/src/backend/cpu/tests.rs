//! The whole renderer's gradients against f64 differences of a plain forward pass, and what one step does with them.

use glam::{Quat, Vec3};

use super::mirror::{Scene, offsets, parameters};
use super::*;
use crate::field::lattice::BRICK_NODES;
use crate::field::{ColorMlp, DensityActivation, Lattice, Occupancy, Ray, SkyGrid, SkyMap};
use crate::quality::render_rays;
use crate::scene::Draws;
use crate::train::ray::{Backdrop, DepthForm, Rates, RayLosses, Rectified, Silhouette, TrainRay};
use crate::volume::Exposure;

/// f32 gradients through 39 + 16 + 16 terms and up to 40 samples; measured near 1e-5.
const TOLERANCE: f64 = 1e-3;
pub(in crate::backend) const LOSSES: RayLosses = RayLosses {
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

pub(in crate::backend) fn field() -> Field {
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
    rays_of_all_sorts(6)
}

/// Rays with and without colour, range and silhouette, in front of the sky or a colour.
pub(in crate::backend) fn rays_of_all_sorts(count: usize) -> Vec<TrainRay> {
    let mut draws = Draws::new(6, 0, 0);
    (0..count)
        .map(|number| {
            let origin = Vec3::new(-2.0, draws.jitter(0.5) as f32, draws.jitter(0.5) as f32);
            let target = Vec3::new(0.5, draws.jitter(0.5) as f32, draws.jitter(0.5) as f32);
            let sort = number % 6;
            TrainRay {
                ray: Ray {
                    origin,
                    direction: (target - origin).normalize_or_zero(),
                },
                phase: 0.5,
                t_max: f32::INFINITY,
                color: std::array::from_fn(|_| draws.unit() as f32),
                color_weight: if sort == 5 { 0.0 } else { 0.2 },
                backdrop: if sort == 1 {
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
                range_weight: if sort >= 4 { 0.1 } else { 0.0 },
                view: number as u32,
                mirrored: false,
            }
        })
        .collect()
}

/// Rays without corrections, under `losses`.
fn scene(losses: RayLosses) -> Scene {
    Scene {
        field: field(),
        rays: rays(),
        losses,
        corrections: Vec::new(),
    }
}

/// Accepts the gradient of every path, and rejects it once `break_it` has changed what kind of gradient it is about.
fn check(scene: &Scene, break_it: impl Fn(&mut [f64])) {
    for simd in Simd::available() {
        let mut gradient = scene.dense_gradient(&scene.run(simd));
        let error = scene.worst_error(&gradient);
        assert!(error < TOLERANCE, "{simd:?}: relative error {error}");
        break_it(&mut gradient);
        let error = scene.worst_error(&gradient);
        assert!(error > 10.0 * TOLERANCE, "broken, and passes with {error}");
    }
}

/// Accepts the scene's gradient and rejects the one of the same scene under other losses, as if a term were forgotten.
fn check_against(scene: &Scene, forgotten: RayLosses) {
    let other = Scene {
        losses: forgotten,
        ..scene.clone()
    };
    let gradient = scene.dense_gradient(&scene.run(Simd::detect()));
    let error = scene.worst_error(&gradient);
    assert!(error < TOLERANCE, "relative error {error}");
    let gradient = other.dense_gradient(&other.run(Simd::detect()));
    let error = scene.worst_error(&gradient);
    assert!(
        error > 10.0 * TOLERANCE,
        "a forgotten term passes with {error}"
    );
}

#[test]
fn the_renderers_gradient_is_right_on_every_path_and_a_broken_one_is_rejected() {
    let scene = scene(LOSSES);
    let (density, features) = offsets(&scene.field).levels[0];
    // Broken: the gradient by density a tenth too large.
    check(&scene, |gradient| {
        gradient[density..features]
            .iter_mut()
            .for_each(|g| *g *= 1.1);
    });
}

#[test]
fn distortion_goes_through_the_whole_renderer() {
    let losses = RayLosses {
        distortion: 0.5,
        ..LOSSES
    };
    check_against(&scene(losses), LOSSES);
}

#[test]
fn the_papers_depth_goes_through_the_whole_renderer() {
    let losses = RayLosses {
        depth: DepthForm::CompositedL1,
        ..LOSSES
    };
    check_against(&scene(losses), LOSSES);
}

#[test]
fn the_printed_rectified_loss_goes_through_the_whole_renderer() {
    let losses = RayLosses {
        rectified: Rectified::Printed,
        ..LOSSES
    };
    check_against(&scene(losses), LOSSES);
}

/// Corrections as large as an annotated cuboid jitters, and every other ray mirrored.
pub(in crate::backend) fn corrected_scene() -> Scene {
    let mut draws = Draws::new(9, 0, 0);
    let mut scene = scene(LOSSES);
    for (number, ray) in scene.rays.iter_mut().enumerate() {
        ray.view = number as u32 / 2;
        ray.mirrored = number % 2 == 1;
    }
    scene.corrections = (0..3)
        .map(|_| {
            let mut three = |most: f64| std::array::from_fn(|_| draws.jitter(most) as f32);
            ViewCorrection {
                exposure: Exposure {
                    log_gain: three(0.3),
                    bias: three(0.1),
                },
                pose: PoseCorrection {
                    rotation: Quat::from_scaled_axis(Vec3::from(three(0.05))),
                    translation_m: three(0.05).into(),
                },
            }
        })
        .collect();
    scene
}

#[test]
fn exposure_and_pose_gradients_are_right_and_a_wrong_arm_or_mirror_is_rejected() {
    let scene = corrected_scene();
    let views = offsets(&scene.field).views;
    // Broken: rotations about the wrong side.
    check(&scene, |gradient| {
        for view in gradient[views..].chunks_exact_mut(12) {
            view[6..9].iter_mut().for_each(|g| *g = -*g);
        }
    });
    // Broken: mirrored rays taken for recorded ones.
    let mut unmirrored = scene.clone();
    for (ray, mirrored) in unmirrored.rays.iter_mut().zip(scene.corrected_rays()) {
        *ray = TrainRay {
            ray: mirrored.ray,
            mirrored: false,
            ..*ray
        };
    }
    unmirrored
        .corrections
        .iter_mut()
        .for_each(|c| c.pose = PoseCorrection::default());
    let gradient = unmirrored.dense_gradient(&unmirrored.run(Simd::detect()));
    assert!(scene.worst_error(&gradient) > 10.0 * TOLERANCE);
}

#[test]
fn a_mirrored_ray_is_corrected_where_it_was_recorded() {
    let pose = PoseCorrection {
        rotation: Quat::from_rotation_z(0.3),
        translation_m: Vec3::new(0.1, 0.2, 0.0),
    };
    let reflect = |v: Vec3| Vec3::new(v.x, -v.y, v.z);
    let ray = Ray {
        origin: Vec3::new(3.0, 1.0, 0.5),
        direction: Vec3::new(-0.8, -0.6, 0.0),
    };
    let mirror = Ray {
        origin: reflect(ray.origin),
        direction: reflect(ray.direction),
    };
    let (plain, mirrored) = (pose.apply(ray, false), pose.apply(mirror, true));
    assert!(plain.origin.distance(reflect(mirrored.origin)) < 1e-6);
    assert!(plain.direction.distance(reflect(mirrored.direction)) < 1e-6);
    assert!(plain.origin.distance(ray.origin) > 0.1);
}

#[test]
fn learned_corrections_have_mean_identity_and_follow_the_views() {
    let mut scene = scene(LOSSES);
    let shown: Vec<Ray> = scene.rays.iter().map(|ray| ray.ray).collect();
    let shown = render_rays(&scene.field, &shown);
    for ((number, ray), shown) in (0u32..).zip(&mut scene.rays).zip(shown) {
        ray.view = number % 3;
        // View 1 was recorded half as bright again.
        let gain = if ray.view == 1 { 1.5 } else { 1.0 };
        ray.color = shown.color.map(|c| c * gain);
        ray.color_weight = 0.2;
        ray.backdrop = Backdrop::SkyAsIs;
    }
    let rates = Rates {
        exposure: 0.01,
        pose_m: 1e-4,
        ..Rates::default()
    };
    let mut trainer = CpuTrainer::new(scene.field.clone(), Simd::detect());
    for _ in 0..200 {
        trainer.step(&scene.rays, &scene.losses, rates);
    }
    let views = trainer.view_corrections();
    assert_eq!(views.len(), 3);
    let level = |c: &ViewCorrection| {
        let corrected = c.exposure.apply([0.4; 3]);
        corrected.iter().sum::<f32>() / 3.0
    };
    assert!(
        level(&views[1]) > 1.2 * level(&views[0]).max(level(&views[2])),
        "{views:?}"
    );
    let gains: f32 = views.iter().flat_map(|v| v.exposure.log_gain).sum();
    let shift: Vec3 = views.iter().map(|v| v.pose.translation_m).sum();
    assert!(
        gains.abs() < 1e-4 && shift.length() < 1e-4,
        "{gains} {shift}"
    );
    assert_eq!(parameters(trainer.field()), parameters(&scene.field));
}

#[test]
fn nothing_is_corrected_unless_a_rate_asks_for_it() {
    let scene = scene(LOSSES);
    let mut trainer = CpuTrainer::new(scene.field.clone(), Simd::detect());
    trainer.step(&scene.rays, &scene.losses, Rates::default());
    assert!(trainer.view_corrections().is_empty());
}

#[test]
fn a_step_moves_every_node_against_its_summed_gradient() {
    let scene = scene(LOSSES);
    let gradient = scene.dense_gradient(&scene.run(Simd::detect()));
    let before = parameters(&scene.field);
    let levels = offsets(&scene.field).levels;
    let mut trainer = CpuTrainer::new(scene.field, Simd::detect());
    let rates = Rates {
        density: 0.01,
        features: 0.01,
        mlp: 0.0,
        sky: 0.0,
        ..Rates::default()
    };
    trainer.step(&scene.rays, &LOSSES, rates);
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
