//! Parity of every stage of a training step: samples, weights, features, colours, losses, gradients.

use glam::{Quat, Vec3};

use super::adapter::on_adapter;
use super::compare::{Cpu, Gpu};
use super::stage_compare::compare_stages;
use crate::backend::cpu::Simd;
use crate::backend::cpu::mirror::Scene;
use crate::backend::cpu::tests::{LOSSES, corrected_scene, field, rays_of_all_sorts};
use crate::backend::gpu::GpuBackend;
use crate::backend::stages::{StageColor, StageSample, Stages};
use crate::field::ColorMlp;
use crate::scene::Draws;
use crate::train::ray::{DepthForm, RayLosses, Rectified};
use crate::volume::Exposure;

const RAYS: usize = 300;

/// The gradient checks' field with a colour network of this width.
fn scene(width: usize, losses: RayLosses) -> Scene {
    let mut draws = Draws::new(13, 0, 0);
    let mut field = field();
    field.mlp = ColorMlp::new(width, || draws.unit());
    Scene {
        field,
        rays: rays_of_all_sorts(RAYS),
        losses,
        corrections: Vec::new(),
    }
}

fn on_gpu(gpu: &GpuBackend, scene: &Scene) -> Gpu<Stages> {
    let mut trainer = gpu.open_trainer(scene.field.clone(), &|| false).unwrap();
    let stages = trainer.stages(&scene.rays, &scene.losses, &scene.corrections);
    Gpu(stages.unwrap())
}

/// On the path without fused multiply-add.
fn on_cpu(scene: &Scene) -> Cpu<Stages> {
    Cpu(scene.stages(Simd::Baseline))
}

/// Asserts that both sides agree on a scene, and that they do not once its losses are `others` on the CPU.
fn agree(name: &str, scene: &Scene, others: RayLosses) {
    on_adapter(name, |gpu| {
        let gpu = on_gpu(gpu, scene);
        let worst = compare_stages(&gpu, &on_cpu(scene)).unwrap();
        println!("{name}: largest deviations {worst:?}");
        let other = Scene {
            losses: others,
            ..scene.clone()
        };
        let verdict = compare_stages(&gpu, &on_cpu(&other));
        assert!(verdict.is_err(), "{name}: other losses pass: {verdict:?}");
    });
}

#[test]
fn parity_of_stages_with_networks_of_all_widths() {
    for width in ColorMlp::WIDTHS {
        let forgotten = RayLosses {
            sample_color: 0.0,
            ..LOSSES
        };
        agree(
            &format!("stages, width {width}"),
            &scene(width, LOSSES),
            forgotten,
        );
    }
}

/// Devices use one of the two; both must be right.
#[test]
fn parity_of_networks_with_one_and_with_four_samples_a_thread() {
    on_adapter("samples a thread", |gpu| {
        // Not a multiple of four slots.
        let mut scene = scene(16, LOSSES);
        while on_cpu(&scene).0.colored().is_multiple_of(4) {
            scene.rays.pop();
        }
        let cpu = on_cpu(&scene);
        for takes_four in [false, true] {
            if takes_four && !gpu.has_four_sample_kernels() {
                println!("LEFT OUT: kernels of four samples need subgroups of eight threads");
                continue;
            }
            let field = scene.field.clone();
            let trainer = gpu.open_variant(field, takes_four);
            let stages = trainer
                .unwrap()
                .stages(&scene.rays, &scene.losses, &[])
                .unwrap();
            let worst = compare_stages(&Gpu(stages.clone()), &cpu).unwrap();
            println!("four: {takes_four}, largest deviations {worst:?}");
            // Broken: the last of every four slots forgotten.
            let mut wrong = Gpu(stages);
            let samples = wrong.0.rays.iter_mut().flatten();
            let colored = samples.filter_map(|sample| sample.colored.as_mut());
            for color in colored.skip(3).step_by(4) {
                color.feature_gradient = [0.0; 12];
            }
            assert!(compare_stages(&wrong, &cpu).is_err());
        }
    });
}

#[test]
fn parity_of_the_entropy_loss() {
    let forgotten = RayLosses {
        entropy: 0.0,
        ..LOSSES
    };
    agree("entropy", &scene(16, LOSSES), forgotten);
}

#[test]
fn parity_of_the_distortion_loss() {
    let losses = RayLosses {
        distortion: 0.5,
        ..LOSSES
    };
    agree("distortion", &scene(16, losses), LOSSES);
}

#[test]
fn parity_of_the_papers_depth_loss() {
    let losses = RayLosses {
        depth: DepthForm::CompositedL1,
        ..LOSSES
    };
    agree("composited depth", &scene(16, losses), LOSSES);
}

#[test]
fn parity_of_the_printed_rectified_loss() {
    let losses = RayLosses {
        rectified: Rectified::Printed,
        ..LOSSES
    };
    agree("printed rectified loss", &scene(16, losses), LOSSES);
}

#[test]
fn parity_of_rays_that_are_trimmed() {
    let losses = RayLosses {
        depth_trim_m: 0.4,
        ..LOSSES
    };
    agree("trimmed depth", &scene(16, losses), LOSSES);
}

/// Makes a scene wrong on purpose.
type Break = fn(&mut Scene);

#[test]
fn parity_of_exposures_and_poses_of_views() {
    on_adapter("exposures and poses", |gpu| {
        let scene = corrected_scene();
        let device = on_gpu(gpu, &scene);
        let right = on_cpu(&scene);
        let worst = compare_stages(&device, &right).unwrap();
        println!("exposures and poses: largest deviations {worst:?}");
        let broken: [(&str, Break); 4] = [
            ("mirrored rays taken for recorded ones", |scene| {
                scene.rays.iter_mut().for_each(|ray| ray.mirrored = false);
            }),
            ("exposures forgotten", |scene| {
                let views = scene.corrections.iter_mut();
                views.for_each(|view| view.exposure = Exposure::default());
            }),
            ("rotations forgotten", |scene| {
                let views = scene.corrections.iter_mut();
                views.for_each(|view| view.pose.rotation = Quat::IDENTITY);
            }),
            ("translations forgotten", |scene| {
                let views = scene.corrections.iter_mut();
                views.for_each(|view| view.pose.translation_m = Vec3::ZERO);
            }),
        ];
        for (what, break_it) in broken {
            let mut other = scene.clone();
            break_it(&mut other);
            let verdict = compare_stages(&device, &on_cpu(&other));
            assert!(verdict.is_err(), "{what} passes: {verdict:?}");
        }
        for part in [0..6, 6..12] {
            let mut wrong = right.clone();
            for view in &mut wrong.0.views {
                scale(&mut view[part.clone()]);
            }
            let verdict = compare_stages(&device, &wrong);
            assert!(verdict.is_err(), "{part:?} a thousandth off: {verdict:?}");
        }
    });
}

/// Only samples whose weight is not within rounding of the threshold decide alike.
#[test]
fn parity_of_what_is_coloured() {
    let losses = RayLosses {
        min_weight: 0.02,
        ..LOSSES
    };
    let mut scene = scene(16, losses);
    let near = |sample: &StageSample| (sample.weight - losses.min_weight).abs() < 1e-4;
    let stages = on_cpu(&scene).0;
    let mut decided = stages.rays.iter().map(|ray| !ray.iter().any(near));
    scene.rays.retain(|_| decided.next().unwrap_or(false));
    assert!(
        scene.rays.len() * 10 > RAYS * 8,
        "{} rays",
        scene.rays.len()
    );
    let colored = on_cpu(&scene).0;
    let colored = colored.rays.iter().flatten().map(|s| s.colored.is_some());
    let (shown, all) = colored.fold((0, 0), |(shown, all), c| (shown + u32::from(c), all + 1));
    assert!(shown > 100 && all > 2 * shown, "{shown} of {all} coloured");
    agree("what is coloured", &scene, LOSSES);
}

/// Every quantity by itself, wrong on purpose.
#[test]
fn parity_of_stages_rejects_every_quantity_that_is_a_little_off() {
    on_adapter("stages a little off", |gpu| {
        let scene = scene(32, LOSSES);
        let gpu = on_gpu(gpu, &scene);
        let right = on_cpu(&scene);
        compare_stages(&gpu, &right).unwrap();
        for (what, change) in CHANGES {
            let mut wrong = right.clone();
            change(&mut wrong.0);
            let verdict = compare_stages(&gpu, &wrong);
            assert!(verdict.is_err(), "{what} passes: {verdict:?}");
        }
    });
}

type Change = fn(&mut Stages);

const CHANGES: [(&str, Change); 14] = [
    ("a lost sample", |s| {
        s.rays[7].pop();
    }),
    ("a lost ray", |s| {
        s.rays.pop();
    }),
    ("a lost level", |s| {
        s.features.pop();
    }),
    ("a sample moved by a tenth of a millimetre", |s| {
        s.rays[7][3].sample.t += 1e-4
    }),
    ("densities a thousandth off", |s| {
        samples(s, |x| x.sample.sigma *= 1.001)
    }),
    ("weights a thousandth off", |s| {
        samples(s, |x| x.weight *= 1.001)
    }),
    ("a sample without colour", |s| s.rays[6][3].colored = None),
    ("features a thousandth off", |s| {
        colors(s, |x| x.features[11] *= 1.001)
    }),
    ("colours a thousandth off", |s| {
        colors(s, |x| x.color[2] *= 1.001)
    }),
    ("raw gradients a thousandth off", |s| {
        samples(s, |x| x.raw *= 1.001)
    }),
    ("feature gradients a thousandth off", |s| {
        colors(s, |x| {
            x.feature_gradient.iter_mut().for_each(|g| *g *= 1.001)
        })
    }),
    ("network gradients a thousandth off", |s| {
        scale(&mut s.network)
    }),
    ("sky gradients a thousandth off", |s| scale(&mut s.sky)),
    ("node gradients a thousandth off", |s| {
        s.density.iter_mut().for_each(|level| scale(level));
        s.features
            .iter_mut()
            .for_each(|level| scale(level.as_flattened_mut()));
    }),
];

fn samples(stages: &mut Stages, change: fn(&mut StageSample)) {
    stages.rays.iter_mut().flatten().for_each(change);
}

fn colors(stages: &mut Stages, change: fn(&mut StageColor)) {
    let colored = stages.rays.iter_mut().flatten();
    colored
        .filter_map(|sample| sample.colored.as_mut())
        .for_each(change);
}

fn scale(values: &mut [f32]) {
    values.iter_mut().for_each(|value| *value *= 1.001);
}
