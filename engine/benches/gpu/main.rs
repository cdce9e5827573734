//! The GPU's kernels beside the CPU's, as processor time of the whole process: on a software adapter both are then comparable,
//! on a machine that does other things too. On a real GPU read the times as what the host spends.
//!
//! `BACKLOT_BENCH_ADAPTER=llvmpipe cargo bench -p backlot-engine --bench gpu`; without the variable, the best GPU.

mod cancel;
mod cpu_time;

use std::time::Duration;

use backlot_engine::backend::bench_scene::{LOSSES, field, rays};
use backlot_engine::backend::cpu::{CpuTrainer, Simd};
use backlot_engine::backend::gpu::GpuBackend;
use backlot_engine::backend::{AdapterChoice, Backend};
use backlot_engine::field::Ray;
use backlot_engine::quality::render_counted;
use backlot_engine::train::ray::Rates;
use criterion::{BenchmarkGroup, Criterion, Throughput, criterion_group, criterion_main};

use cpu_time::{CpuTime, now};

const RAYS: usize = 2048;
const WIDTH: usize = 128;
/// Samples a thread of the colour network.
const VARIANTS: [(&str, bool); 2] = [("1 sample a thread", false), ("4 samples a thread", true)];

/// Those that the device runs.
fn variants(gpu: &GpuBackend) -> impl Iterator<Item = (&'static str, bool)> {
    let has_four = gpu.has_four_sample_kernels();
    let runs = move |variant: &(&str, bool)| !variant.1 || has_four;
    VARIANTS.into_iter().filter(runs)
}
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
    let mut on_cpu = 0;
    let cpu = least_time(&mut group, "cpu, rays", || {
        on_cpu = render_counted(&field, &plain).1 as u64;
    });
    let gpu = GpuBackend::open(&adapter(), 1 << 30).expect("an adapter");
    eprintln!("gpu: {}", gpu.device());
    for (name, takes_four) in variants(&gpu) {
        let trainer = gpu.open_variant(field.clone(), takes_four);
        let mut trainer = trainer.expect("the field fits");
        let mut on_gpu = 0;
        let least = least_time(&mut group, &format!("gpu, {name}, rays"), || {
            on_gpu = trainer.forward(&rays, &LOSSES).expect("the device works");
        });
        report(name, (cpu, on_cpu), (least, on_gpu));
    }
    group.finish();
}

fn step(c: &mut Criterion<CpuTime>) {
    let rays = rays(RAYS);
    let mut group = c.benchmark_group("training step");
    group
        .sample_size(10)
        .throughput(Throughput::Elements(RAYS as u64));
    let mut colored = 0;
    let mut exact = CpuTrainer::new(field(WIDTH), Simd::detect());
    let in_f32 = least_time(&mut group, "cpu in f32, rays", || {
        colored = exact.step(&rays, &LOSSES, RATES).colored;
    });
    drop(exact);
    let mut fastest = CpuTrainer::fastest(field(WIDTH));
    let at_best = least_time(&mut group, "cpu at its fastest, rays", || {
        colored = fastest.step(&rays, &LOSSES, RATES).colored;
    });
    drop(fastest);
    let gpu = GpuBackend::open(&adapter(), 1 << 30).expect("an adapter");
    for (name, takes_four) in variants(&gpu) {
        let trainer = gpu.open_variant(field(WIDTH), takes_four);
        let mut trainer = trainer.expect("the field fits");
        let mut on_gpu = 0;
        let least = least_time(&mut group, &format!("gpu, {name}, rays"), || {
            let stepped = trainer.step(&rays, &LOSSES, RATES, 0.0, &|| false);
            stepped.expect("the device works");
            on_gpu = trainer.sums().expect("the device works").colored;
        });
        report(
            &format!("{name}, cpu in f32"),
            (in_f32, colored),
            (least, on_gpu),
        );
        report(
            &format!("{name}, cpu at its fastest"),
            (at_best, colored),
            (least, on_gpu),
        );
    }
    group.finish();
}

/// Runs a benchmark and returns the least processor time that an iteration took; zero if the command line left it out.
fn least_time(
    group: &mut BenchmarkGroup<'_, CpuTime>,
    name: &str,
    mut run: impl FnMut(),
) -> Duration {
    let mut least = Duration::MAX;
    group.bench_function(name, |b| {
        b.iter_custom(|iterations| {
            let mut all = Duration::ZERO;
            for _ in 0..iterations {
                let began = now();
                run();
                let took = now().saturating_sub(began);
                least = least.min(took);
                all += took;
            }
            all
        });
    });
    if least == Duration::MAX {
        Duration::ZERO
    } else {
        least
    }
}

/// Says which part of the CPU's rate the GPU's is; both are the least time and the samples that were coloured in it.
///
/// # Panics
/// If the two sides did not colour the same samples.
fn report(name: &str, cpu: (Duration, u64), gpu: (Duration, u64)) {
    if cpu.0.is_zero() || gpu.0.is_zero() {
        return;
    }
    assert_eq!(cpu.1, gpu.1, "{name}: samples coloured on CPU and GPU");
    eprintln!(
        "{name}: 1/{:.1} of the CPU's rate; both colour {} samples of {RAYS} rays, {:.1} a ray",
        gpu.0.as_secs_f64() / cpu.0.as_secs_f64(),
        gpu.1,
        gpu.1 as f64 / RAYS as f64
    );
}

/// Which kernels a step's time goes to; printed once, in full runs and where `kernels` is asked for.
fn kernels(_: &mut Criterion<CpuTime>) {
    let mut asked = std::env::args().skip(1).filter(|arg| !arg.starts_with('-'));
    if !asked
        .next()
        .is_none_or(|filter| "kernels".contains(&filter))
    {
        return;
    }
    let rays = rays(RAYS);
    let gpu = GpuBackend::open(&adapter(), 1 << 30).expect("an adapter");
    for (name, takes_four) in variants(&gpu) {
        let trainer = gpu.open_variant(field(WIDTH), takes_four);
        let mut trainer = trainer.expect("the field fits");
        // The first step compiles.
        for _ in 0..2 {
            let stepped = trainer.step(&rays, &LOSSES, RATES, 0.0, &|| false);
            stepped.expect("the device works");
        }
        let times = trainer.kernel_times(&rays, &LOSSES, RATES, now);
        let times = times.expect("the device works");
        let whole: Duration = times.spent().iter().map(|(_, spent)| *spent).sum();
        eprintln!("kernels of a step, {name}: {whole:.1?} one by one");
        for (kernel, spent) in times.spent() {
            eprintln!("  {:>9.1?} {kernel}", spent);
        }
    }
}

fn between_cancel_checks(c: &mut Criterion<CpuTime>) {
    let gpu = GpuBackend::open(&adapter(), 1 << 30).expect("an adapter");
    cancel::cancel(c, &gpu);
}

criterion_group! {
    name = benches;
    config = Criterion::default().with_measurement(CpuTime);
    targets = forward, step, kernels, between_cancel_checks
}
criterion_main!(benches);
