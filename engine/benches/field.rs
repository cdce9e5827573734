//! Rates of the engine's main loops on a small street-like scene: marching, colour, training and the stored form.
//!
//! `cargo bench -p backlot-engine --no-default-features`. The scene is a checkered road seen by ten forward cameras, a metre apart.

use std::hint::black_box;

use backlot_engine::asset::{Asset, AssetHeader, AssetKind, ColorSpace, FORMAT_VERSION, Usage};
use backlot_engine::backend::cpu::CpuBackend;
use backlot_engine::camera::{Camera, Distortion, Rigid};
use backlot_engine::class::ObjectClass;
use backlot_engine::field::{ColorScratch, Field};
use backlot_engine::train::{BackgroundInput, Budget, NoControl, TrainPreset, train_background};
use backlot_engine::view::{DepthReturn, PixelLabel, Split, TrainView};
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use glam::{DMat3, DQuat, DVec2, DVec3, Vec3};

const STEPS: u64 = 60;

fn view(number: u32) -> TrainView {
    let camera = Camera {
        width: 160,
        height: 96,
        focal_px: DVec2::splat(130.0),
        principal_px: DVec2::new(80.0, 40.0),
        distortion: Distortion::None,
    };
    let axes = DMat3::from_cols(DVec3::NEG_Y, DVec3::NEG_Z, DVec3::X);
    let eye = DVec3::new(f64::from(number), 0.0, 1.6);
    let local_from_camera = Rigid::new(DQuat::from_mat3(&axes), eye);
    let (mut rgb, mut labels, mut depth) = (Vec::new(), Vec::new(), Vec::new());
    for pixel in 0..camera.width * camera.height {
        let at = DVec2::new(
            f64::from(pixel % camera.width) + 0.5,
            f64::from(pixel / camera.width) + 0.5,
        );
        let direction = local_from_camera.direction(camera.direction(at));
        let range_m = -eye.z / direction.z;
        if direction.z >= 0.0 || range_m > 60.0 {
            rgb.extend([140, 170, 220]);
            labels.push(PixelLabel::Sky);
            continue;
        }
        let p = eye + direction * range_m;
        let light = (p.x.floor() + p.y.floor()) as i64 % 2 == 0;
        rgb.extend(if light { [150; 3] } else { [90; 3] });
        labels.push(PixelLabel::Foreground);
        if pixel % 3 == 0 {
            depth.push(DepthReturn::lidar(at.as_vec2().to_array(), range_m as f32));
        }
    }
    TrainView {
        frame_index: number,
        camera,
        local_from_camera,
        rgb,
        labels,
        depth,
        split: Split::Train,
    }
}

fn street() -> BackgroundInput {
    let views: Vec<TrainView> = (0..10).map(view).collect();
    let lidar_points = views.iter().flat_map(|view| {
        view.depth.iter().map(|hit| {
            let pixel = DVec2::new(f64::from(hit.pixel[0]), f64::from(hit.pixel[1]));
            let along = view.camera.direction(pixel) * f64::from(hit.range_m);
            view.local_from_camera.point(along).as_vec3().to_array()
        })
    });
    BackgroundInput {
        lidar_points: lidar_points.collect(),
        beams: Vec::new(),
        ego_path: views
            .iter()
            .map(|v| v.local_from_camera.translation_m)
            .collect(),
        views,
    }
}

fn preset(steps: u64) -> TrainPreset {
    TrainPreset {
        steps,
        ..TrainPreset::background(Budget::Quick)
    }
}

/// Rays of the fifth view, as (origin, direction).
fn rays() -> Vec<(Vec3, Vec3)> {
    let view = view(5);
    (0..view.camera.pixel_count())
        .map(|at| view.pixel_ray(at))
        .map(|ray| (ray.origin, ray.direction))
        .collect()
}

fn march(c: &mut Criterion, field: &Field) {
    let rays = rays();
    let mut group = c.benchmark_group("march");
    group.throughput(Throughput::Elements(rays.len() as u64));
    let mut samples = Vec::new();
    group.bench_function("rays, one thread", |b| {
        b.iter(|| {
            for (origin, direction) in &rays {
                samples.clear();
                field.march(*origin, *direction, 0.1, 100.0, 7.0, &mut samples);
                black_box(&samples);
            }
        });
    });
    group.finish();
}

fn colors(c: &mut Criterion, field: &Field) {
    let positions: Vec<Vec3> = (0..4_096)
        .map(|i| {
            Vec3::new(
                4.0 + (i % 64) as f32 * 0.1,
                (i / 64) as f32 * 0.1 - 3.2,
                0.0,
            )
        })
        .collect();
    let directions = vec![Vec3::X; positions.len()];
    let (mut out, mut scratch) = (Vec::new(), ColorScratch::default());
    let mut group = c.benchmark_group("colors");
    group.throughput(Throughput::Elements(positions.len() as u64));
    group.bench_function("samples, one thread", |b| {
        b.iter(|| field.colors(&positions, &directions, &mut out, &mut scratch));
    });
    group.finish();
}

fn train(c: &mut Criterion, input: &BackgroundInput) {
    let preset = preset(STEPS);
    let rays = (preset.mix.pixel_rays + preset.mix.depth_rays) as u64 * STEPS;
    let mut group = c.benchmark_group("train");
    group.sample_size(10);
    group.throughput(Throughput::Elements(rays));
    group.bench_function("rays, all threads, from preparing to evaluated", |b| {
        b.iter(|| train_background(input, &preset, 1, &CpuBackend, &NoControl).expect("trains"));
    });
    group.finish();
}

fn stored_form(c: &mut Criterion, field: Field) {
    let asset = Asset {
        header: AssetHeader {
            format_version: FORMAT_VERSION,
            kind: AssetKind::Background,
            class: ObjectClass::Other,
            size_m: DVec3::ZERO,
            symmetric: false,
            usage: Usage::Library,
            usage_reason: String::new(),
            local_from_world: Rigid::IDENTITY,
            source_log: String::new(),
            source_track_id: String::new(),
            synthetic: true,
            quality: Default::default(),
            coverage: None,
            recording: None,
            valid_region: None,
            ego_from_object: Vec::new(),
            color_space: ColorSpace::Srgb,
            exposure_ev: 0.0,
        },
        field: field.into(),
    };
    let bytes = asset.encode();
    let mut group = c.benchmark_group("asset");
    group.sample_size(10);
    group.throughput(Throughput::Bytes(bytes.len() as u64));
    group.bench_function("encode", |b| b.iter(|| asset.encode()));
    group.bench_function("decode", |b| {
        b.iter(|| Asset::decode(&bytes).expect("decodes"));
    });
    group.finish();
}

fn all(c: &mut Criterion) {
    let input = street();
    let field = train_background(&input, &preset(STEPS), 1, &CpuBackend, &NoControl)
        .expect("trains")
        .field;
    march(c, &field);
    colors(c, &field);
    train(c, &input);
    stored_form(c, field);
}

criterion_group!(benches, all);
criterion_main!(benches);
