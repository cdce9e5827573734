//! What placed objects cost: a 1242x375 sample with three of them that cover at least 15 % of its pixels, against its background alone.
//!
//! `cargo bench -p backlot-engine --no-default-features --bench compose`. The limit is 1.3 times the background's time. The scene is a
//! road between two walls, the objects are boxes of a car's size, all of them trained here for a few hundred steps.

use std::hint::black_box;
use std::sync::Arc;

use backlot_engine::Field;
use backlot_engine::backend::cpu::CpuBackend;
use backlot_engine::camera::{Camera, Distortion, Rigid};
use backlot_engine::scene::{RenderOptions, Scene, SceneObject, Tone, render};
use backlot_engine::train::{
    BackgroundInput, Budget, NoControl, ObjectInput, TrainPreset, train_background, train_object,
};
use backlot_engine::view::{DepthReturn, PixelLabel, Split, TrainView};
use criterion::{Criterion, criterion_group, criterion_main};
use glam::{DMat3, DQuat, DVec2, DVec3};

const STEPS: u64 = 400;
const CAR: DVec3 = DVec3::new(4.3, 1.8, 1.5);
/// Where the objects stand, by x, y and heading, seen from x = 6 m.
const PLACES: [(f64, f64, f64); 3] = [(14.5, -1.9, 0.1), (15.0, 1.8, 3.0), (23.0, 0.0, 0.0)];
const LEAST_COVER: f64 = 0.15;

fn camera(width: u32, height: u32) -> Camera {
    let focal = 0.58 * f64::from(width);
    Camera {
        width,
        height,
        focal_px: DVec2::splat(focal),
        principal_px: DVec2::new(f64::from(width), f64::from(height)) * 0.5,
        distortion: Distortion::None,
    }
}

/// Camera axes that look along x, z up.
fn forward() -> DQuat {
    DQuat::from_mat3(&DMat3::from_cols(DVec3::NEG_Y, DVec3::NEG_Z, DVec3::X))
}

/// Distance to the road and the two walls, and their brightness there; `None` for the sky.
fn street(eye: DVec3, direction: DVec3) -> Option<(f64, u8)> {
    let mut nearest: Option<(f64, u8)> = None;
    let mut meet = |range: f64, ok: bool, at: [f64; 2]| {
        let nearer = nearest.is_none_or(|(best, _)| range < best);
        if ok && range > 0.1 && range < 70.0 && nearer {
            let light = (at[0].floor() + at[1].floor()) as i64 % 2 == 0;
            nearest = Some((range, if light { 150 } else { 90 }));
        }
    };
    let road = -eye.z / direction.z;
    let p = eye + direction * road;
    meet(road, p.y.abs() < 8.0, [p.x, p.y]);
    for side in [-8.0, 8.0] {
        let wall = (side - eye.y) / direction.y;
        let p = eye + direction * wall;
        meet(wall, (0.0..7.0).contains(&p.z), [p.x * 0.5, p.z * 0.5]);
    }
    nearest
}

/// Distance to the car's box and its brightness there.
fn car(eye: DVec3, direction: DVec3) -> Option<(f64, u8)> {
    let (a, b) = (
        (-CAR * 0.5 - eye) / direction,
        (CAR * 0.5 - eye) / direction,
    );
    let (enter, leave) = (a.min(b).max_element(), a.max(b).min_element());
    let p = eye + direction * enter;
    let stripe = ((p.z + 4.0) * 4.0).floor() as i64 % 2 == 0;
    (enter > 0.0 && enter < leave).then_some((enter, if stripe { 200 } else { 60 }))
}

fn view(
    number: u32,
    camera: Camera,
    pose: Rigid,
    otherwise: PixelLabel,
    meet: impl Fn(DVec3, DVec3) -> Option<(f64, u8)>,
) -> TrainView {
    let (mut rgb, mut labels, mut depth) = (Vec::new(), Vec::new(), Vec::new());
    for pixel in 0..camera.width * camera.height {
        let at = DVec2::new(
            f64::from(pixel % camera.width) + 0.5,
            f64::from(pixel / camera.width) + 0.5,
        );
        let direction = pose.direction(camera.direction(at)).normalize();
        let Some((range_m, grey)) = meet(pose.translation_m, direction) else {
            rgb.extend([140, 170, 220]);
            labels.push(otherwise);
            continue;
        };
        rgb.extend([grey; 3]);
        labels.push(PixelLabel::Foreground);
        if pixel % 3 == 0 {
            depth.push(DepthReturn::lidar(at.as_vec2().to_array(), range_m as f32));
        }
    }
    TrainView {
        frame_index: number,
        camera,
        local_from_camera: pose,
        rgb,
        labels,
        depth,
        split: Split::Train,
    }
}

fn points(views: &[TrainView]) -> Vec<[f32; 3]> {
    let hits = views.iter().flat_map(|view| {
        view.depth.iter().map(|hit| {
            let pixel = DVec2::new(f64::from(hit.pixel[0]), f64::from(hit.pixel[1]));
            let along = view.camera.direction(pixel).normalize() * f64::from(hit.range_m);
            view.local_from_camera.point(along).as_vec3().to_array()
        })
    });
    hits.collect()
}

fn background() -> Field {
    let pose = |i: u32| Rigid::new(forward(), DVec3::new(2.0 * f64::from(i), 0.0, 1.6));
    let views: Vec<TrainView> = (0..12)
        .map(|i| view(i, camera(310, 94), pose(i), PixelLabel::Sky, street))
        .collect();
    let input = BackgroundInput {
        lidar_points: points(&views),
        beams: Vec::new(),
        ego_path: views
            .iter()
            .map(|v| v.local_from_camera.translation_m)
            .collect(),
        views,
    };
    let preset = TrainPreset {
        steps: STEPS,
        ..TrainPreset::background(Budget::Quick)
    };
    train_background(&input, &preset, 1, &CpuBackend, &NoControl)
        .expect("trains")
        .field
}

fn object() -> Field {
    let pose = |i: u32| {
        let turn = DQuat::from_rotation_z(f64::from(i) * std::f64::consts::TAU / 12.0);
        // Looks back at the origin from 8 m.
        Rigid::new(turn * forward(), turn * DVec3::new(-8.0, 0.0, 0.6))
    };
    let views: Vec<TrainView> = (0..12)
        .map(|i| view(i, camera(200, 100), pose(i), PixelLabel::Background, car))
        .collect();
    let input = ObjectInput {
        lidar_points: points(&views),
        size_m: CAR,
        symmetric: false,
        views,
    };
    let preset = TrainPreset {
        steps: STEPS,
        ..TrainPreset::object(Budget::Quick)
    };
    train_object(&input, &preset, 1, &CpuBackend, &NoControl)
        .expect("trains")
        .field
}

fn compose(c: &mut Criterion) {
    let (background, object) = (Arc::new(background()), Arc::new(object()));
    let placed = |(i, (x, y, heading)): (usize, &(f64, f64, f64))| SceneObject {
        instance_id: i as u16 + 1,
        field: &object,
        local_from_object: Rigid::from_heading(*heading, DVec3::new(*x, *y, 0.5 * CAR.z)),
        size_m: CAR,
        tone: Tone::IDENTITY,
    };
    let scene = |objects: &[(f64, f64, f64)]| Scene {
        background: Some(&background),
        objects: objects.iter().enumerate().map(placed).collect(),
        statics: Vec::new(),
        camera: camera(1242, 375),
        local_from_camera: Rigid::new(forward(), DVec3::new(6.0, 0.0, 1.6)),
    };
    let (alone, composed) = (scene(&[]), scene(&PLACES));
    let run =
        |scene: &Scene<'_>| render(scene, &RenderOptions::default(), &|| false).expect("renders");
    let frame = run(&composed);
    let covered = frame.instance.iter().filter(|id| **id != 0).count();
    let covered = covered as f64 / frame.instance.len() as f64;
    assert!(
        covered >= LEAST_COVER,
        "objects cover only {covered:.3} of the image"
    );
    eprintln!("three objects cover {:.1} % of the pixels", 100.0 * covered);
    let mut group = c.benchmark_group("1242x375, all threads");
    group.sample_size(10);
    group.bench_function("background alone", |b| b.iter(|| black_box(run(&alone))));
    group.bench_function("with three objects", |b| {
        b.iter(|| black_box(run(&composed)))
    });
    group.finish();
}

criterion_group!(benches, compose);
criterion_main!(benches);
