//! Parity of `march_density`.

use std::sync::Arc;

use glam::Vec3;

use super::adapter::{on_adapter, open};
use super::compare::{Cpu, Gpu, compare};
use crate::backend::gpu::GpuBackend;
use crate::backend::test_scene::{SAMPLES_PER_RAY, away_from_faces, field, march, march_cpu, rays};
use crate::backend::{Backend, MarchRay, Marched, RaySummary};
use crate::field::{Field, RaySample};
use crate::{Error, ErrorKind};

#[test]
fn parity_of_marching() {
    on_adapter("march_density", |gpu| {
        let (field, rays, gpu) = both(gpu);
        let cpu = Cpu(march_cpu(&field, &rays));
        assert_scene_is_worth_comparing(&cpu.0, &rays);
        let worst = compare(&gpu, &cpu).unwrap();
        println!("largest deviations over {} rays: {worst:?}", rays.len());
    });
}

#[test]
fn parity_rejects_a_field_moved_by_a_tenth_of_a_voxel() {
    rejects("field moved by 0.02 m", |field, rays| {
        let moved: Vec<MarchRay> = rays
            .iter()
            .map(|ray| {
                let mut ray = *ray;
                ray.ray.origin += Vec3::new(0.0, 0.02, 0.0);
                ray
            })
            .collect();
        march_cpu(field, &moved)
    });
}

#[test]
fn parity_rejects_a_lost_last_sample() {
    rejects("last sample lost", |field, rays| {
        altered(&march_cpu(field, rays), |samples| {
            samples.pop();
        })
    });
}

#[test]
fn parity_rejects_densities_a_thousandth_off() {
    rejects("sigma off by 0.1 %", |field, rays| {
        altered(&march_cpu(field, rays), |samples| {
            samples.iter_mut().for_each(|sample| sample.sigma *= 1.001)
        })
    });
}

#[test]
fn parity_rejects_another_phase() {
    rejects("phase off by 0.01", |field, rays| {
        let mut rays = rays.to_vec();
        rays.iter_mut().for_each(|ray| ray.range.phase += 0.01);
        march_cpu(field, &rays)
    });
}

/// Rays on faces and edges, along axes, with ranges that mean nothing: what comes back is finite and a proper composite.
#[test]
fn parity_inputs_on_faces_stay_finite() {
    on_adapter("rays on faces", |gpu| {
        let loaded = gpu.load(&Arc::new(field())).unwrap();
        let marched = march(loaded.as_ref(), &degenerate_rays());
        assert!(
            marched
                .summaries()
                .iter()
                .any(|summary| summary.sample_count > 0),
            "no ray hit anything"
        );
        for (ray, summary) in marched.summaries().iter().enumerate() {
            let RaySummary {
                tau,
                accumulation,
                weighted_distance_m,
                ..
            } = *summary;
            assert!(
                tau.is_finite() && tau >= 0.0 && weighted_distance_m.is_finite(),
                "ray {ray}: {summary:?}"
            );
            assert!(
                (0.0..=1.0 + 1e-5).contains(&accumulation),
                "ray {ray}: {summary:?}"
            );
            let times = marched.samples(ray).windows(2);
            assert!(
                times.into_iter().all(|pair| pair[0].t < pair[1].t),
                "ray {ray}: samples out of order"
            );
        }
    });
}

#[test]
fn parity_of_refusals() {
    on_adapter("refusals", |gpu| {
        let field = Arc::new(field());
        let loaded = gpu.load(&field).unwrap();
        let rays = rays();
        let too_many = loaded.march(&rays, 3, &|| false).unwrap_err();
        assert_eq!(too_many.kind(), ErrorKind::Invalid, "{too_many}");
        let cancelled = loaded.march(&rays, SAMPLES_PER_RAY, &|| true).unwrap_err();
        assert!(matches!(cancelled, Error::Cancelled), "{cancelled}");
    });
}

/// Its own device, since it is destroyed.
#[test]
fn parity_of_a_lost_device_is_a_typed_error() {
    on_adapter("lost device", |shared| {
        let field = Arc::new(field());
        // Something dispatched on the shared device shows that only the other one is lost.
        let gpu = open().unwrap();
        let loaded = gpu.load(&field).unwrap();
        gpu.device.destroy();
        let error = loaded
            .march(&rays(), SAMPLES_PER_RAY, &|| false)
            .unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Unavailable, "{error}");
        march(shared.load(&field).unwrap().as_ref(), &rays()[..8]);
    });
}

/// The field, the rays on which decisions can be compared exactly, and what the device makes of them.
fn both(gpu: &GpuBackend) -> (Arc<Field>, Vec<MarchRay>, Gpu<Marched>) {
    let field = Arc::new(field());
    let all = rays();
    let rays = away_from_faces(&field, &all);
    assert!(
        rays.len() * 10 >= all.len() * 9,
        "only {} of {} rays are away from faces",
        rays.len(),
        all.len()
    );
    let marched = march(gpu.load(&field).unwrap().as_ref(), &rays);
    (field, rays, Gpu(marched))
}

/// Asserts that the comparison notices a CPU side that is wrong on purpose.
fn rejects(what: &str, wrong: impl FnOnce(&Arc<Field>, &[MarchRay]) -> Marched) {
    on_adapter(what, |gpu| {
        let (field, rays, gpu) = both(gpu);
        let verdict = compare(&gpu, &Cpu(wrong(&field, &rays)));
        assert!(
            verdict.is_err(),
            "{what} passed the comparison: {verdict:?}"
        );
    });
}

/// The result with every ray's samples changed and composited anew.
fn altered(marched: &Marched, change: impl Fn(&mut Vec<RaySample>)) -> Marched {
    let mut altered = Marched::with_capacity(marched.summaries().len());
    for ray in 0..marched.summaries().len() {
        let mut samples = marched.samples(ray).to_vec();
        change(&mut samples);
        altered
            .push(RaySummary::composite(&samples), &samples, SAMPLES_PER_RAY)
            .unwrap();
    }
    altered
}

fn assert_scene_is_worth_comparing(cpu: &Marched, rays: &[MarchRay]) {
    let count = |test: &dyn Fn(&RaySummary, &MarchRay) -> bool| {
        cpu.summaries()
            .iter()
            .zip(rays)
            .filter(|(summary, ray)| test(summary, ray))
            .count()
    };
    let missed = count(&|summary, _| summary.sample_count == 0);
    let stopped = count(&|summary, ray| summary.tau > ray.range.stop_tau);
    let translucent = count(&|summary, _| (0.05..0.95).contains(&summary.accumulation));
    let long = count(&|summary, _| summary.sample_count > 64);
    assert!(
        missed > 10 && stopped > 10 && translucent > 10 && long > 10,
        "{missed} missed, {stopped} stopped early, {translucent} translucent, {long} long"
    );
}

fn degenerate_rays() -> Vec<MarchRay> {
    let template = rays()[0];
    let origins = [
        Vec3::new(-3.0, -4.0, -1.0),
        Vec3::new(-5.0, -4.0, -1.0),
        Vec3::new(-5.0, 0.0, 0.6),
        Vec3::new(1.0, 0.8, 2.2),
        Vec3::new(9.8, 5.6, 5.4),
        Vec3::splat(1e6),
    ];
    let directions = [
        Vec3::X,
        Vec3::NEG_X,
        Vec3::Y,
        Vec3::Z,
        Vec3::new(0.6, 0.8, 0.0),
        Vec3::new(0.0, -0.6, 0.8),
        Vec3::ZERO,
    ];
    let ranges = [
        (0.0, 20.0),
        (-1.0, f32::INFINITY),
        (5.0, 1.0),
        (0.0, 0.0),
        (0.0, f32::NAN),
    ];
    let mut rays = Vec::new();
    for origin in origins {
        for direction in directions {
            for (t_min, t_max) in ranges {
                let mut ray = template;
                (ray.ray.origin, ray.ray.direction) = (origin, direction);
                (ray.range.t_min, ray.range.t_max, ray.range.stop_tau) = (t_min, t_max, 9.0);
                rays.push(ray);
            }
        }
    }
    rays
}
