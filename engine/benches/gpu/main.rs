//! The GPU's kernels beside the CPU's, as processor time of the whole process: on a software adapter both are then comparable,
//! on a machine that does other things too. On a real GPU read the times as what the host spends.
//!
//! `BACKLOT_BENCH_ADAPTER=llvmpipe cargo bench -p backlot-engine --bench gpu`; without the variable, the best GPU.

mod cancel;
mod cpu_time;

use backlot_engine::backend::bench_scene::{LOSSES, field, rays};
use backlot_engine::backend::cpu::{CpuTrainer, Simd};
use backlot_engine::backend::gpu::GpuBackend;
use backlot_engine::backend::{AdapterChoice, Backend};
use backlot_engine::field::Ray;
use backlot_engine::quality::render_rays;
use backlot_engine::train::ray::Rates;
use criterion::{Criterion, Throughput, criterion_group, criterion_main};

use cpu_time::CpuTime;

const RAYS: usize = 2048;
const WIDTH: usize = 128;
/// Samples a thread of the colour network.
const VARIANTS: [(&str, bool); 2] = [("1 sample a thread", false), ("4 samples a thread", true)];
const RATES: Rates = Rates {
    density: 0.0,
    features: 0.0,
    mlp: 0.0,
    sky: 0.0,
    exposure: 0.0,
    pose_m: 0.0,
};

fn adapter() -> AdapterChoice {
    match std::env::var("BACKLOT_BENCH_ADAPTER") {
        Ok(name) => AdapterChoice::Name(name),
        Err(_) => AdapterChoice::Best,
    }
}

fn forward(c: &mut Criterion<CpuTime>) {
    let rays = rays(RAYS);
    let plain: Vec<Ray> = rays.iter().map(|ray| ray.ray).collect();
    let field = field(WIDTH);
    let mut group = c.benchmark_group("forward");
    group
        .sample_size(10)
        .throughput(Throughput::Elements(RAYS as u64));
    group.bench_function("cpu, rays", |b| b.iter(|| render_rays(&field, &plain)));
    let gpu = GpuBackend::open(&adapter(), 1 << 30).expect("an adapter");
    eprintln!("gpu: {}", gpu.device());
    for (name, takes_four) in VARIANTS {
        let trainer = gpu.open_variant(field.clone(), takes_four);
        let mut trainer = trainer.expect("the field fits");
        group.bench_function(format!("gpu, {name}, rays"), |b| {
            b.iter(|| trainer.forward(&rays, &LOSSES).expect("the device works"));
        });
    }
    group.finish();
}

fn step(c: &mut Criterion<CpuTime>) {
    let rays = rays(RAYS);
    let mut group = c.benchmark_group("training step");
    group
        .sample_size(10)
        .throughput(Throughput::Elements(RAYS as u64));
    let mut exact = CpuTrainer::new(field(WIDTH), Simd::detect());
    group.bench_function("cpu in f32, rays", |b| {
        b.iter(|| exact.step(&rays, &LOSSES, RATES).colored);
    });
    drop(exact);
    let mut fastest = CpuTrainer::fastest(field(WIDTH));
    group.bench_function("cpu at its fastest, rays", |b| {
        b.iter(|| fastest.step(&rays, &LOSSES, RATES).colored);
    });
    drop(fastest);
    let gpu = GpuBackend::open(&adapter(), 1 << 30).expect("an adapter");
    for (name, takes_four) in VARIANTS {
        let trainer = gpu.open_variant(field(WIDTH), takes_four);
        let mut trainer = trainer.expect("the field fits");
        group.bench_function(format!("gpu, {name}, rays"), |b| {
            b.iter(|| {
                let stepped = trainer.step(&rays, &LOSSES, RATES, 0.0, &|| false);
                stepped.expect("the device works");
                trainer.sums().expect("the device works")
            });
        });
    }
    group.finish();
}

fn between_cancel_checks(c: &mut Criterion<CpuTime>) {
    let gpu = GpuBackend::open(&adapter(), 1 << 30).expect("an adapter");
    cancel::cancel(c, &gpu);
}

criterion_group! {
    name = benches;
    config = Criterion::default().with_measurement(CpuTime);
    targets = forward, step, between_cancel_checks
}
criterion_main!(benches);
