//! How much work lies between two questions whether a call is cancelled, at most: what a cancelled call may still cost. On a software
//! adapter all of it is processor time of this process; divide by the processors for what a caller waits.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use backlot_engine::backend::Backend;
use backlot_engine::backend::bench_scene::{LOSSES, field, rays};
use backlot_engine::backend::gpu::GpuBackend;
use backlot_engine::camera::{Camera, Distortion, Rigid};
use backlot_engine::scene::{RenderOptions, Scene};
use backlot_engine::train::ray::Rates;
use criterion::Criterion;
use glam::{DMat3, DQuat, DVec2, DVec3};

use crate::cpu_time::{CpuTime, now};

const WIDTH: usize = 128;
/// Of a step of the paper's preset.
const RAYS: usize = 4096;
const RATES: Rates = Rates {
    density: 0.01,
    features: 0.01,
    mlp: 1e-3,
    sky: 0.0,
    exposure: 0.0,
    pose_m: 0.0,
};

/// Longest time between questions.
#[derive(Default)]
struct Gaps(Mutex<(Option<Duration>, Duration)>);

impl Gaps {
    fn ask(&self) -> bool {
        let mut gaps = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let now = now();
        if let Some(last) = gaps.0 {
            gaps.1 = gaps.1.max(now.saturating_sub(last));
        }
        gaps.0 = Some(now);
        false
    }

    fn longest(self) -> Duration {
        self.0
            .into_inner()
            .unwrap_or_else(PoisonError::into_inner)
            .1
    }
}

/// Reported are the longest gaps of a step and of a frame, as if they were what one iteration takes.
pub(crate) fn cancel(c: &mut Criterion<CpuTime>, gpu: &GpuBackend) {
    let mut group = c.benchmark_group("longest work between two cancel checks");
    group.sample_size(10);
    let field = field(WIDTH);
    let rays = rays(RAYS);
    let mut trainer = gpu
        .open_trainer(field.clone(), &|| false)
        .expect("the field fits");
    group.bench_function("training step", |b| {
        b.iter_custom(|steps| {
            let longest = (0..steps).map(|_| {
                let gaps = Gaps::default();
                let stepped = trainer.step(&rays, &LOSSES, RATES, 0.0, &|| gaps.ask());
                stepped.expect("the device works");
                gaps.longest()
            });
            longest.sum()
        });
    });
    let background = Arc::new(field);
    let scene = Scene {
        background: Some(&background),
        objects: Vec::new(),
        statics: Vec::new(),
        camera: Camera {
            width: 310,
            height: 94,
            focal_px: DVec2::splat(180.0),
            principal_px: DVec2::new(155.0, 47.0),
            distortion: Distortion::None,
        },
        local_from_camera: Rigid::new(
            DQuat::from_mat3(&DMat3::from_cols(-DVec3::Y, -DVec3::Z, DVec3::X)),
            DVec3::new(-8.0, 0.0, 0.0),
        ),
    };
    group.bench_function("frame", |b| {
        b.iter_custom(|frames| {
            let longest = (0..frames).map(|_| {
                let gaps = Gaps::default();
                let frame = gpu.render(&scene, &RenderOptions::default(), &|| gaps.ask());
                frame.expect("the device works");
                gaps.longest()
            });
            longest.sum()
        });
    });
    group.finish();
}
