//! Rates of the kernels that training spends its time in, on one thread but for the scatter, which takes all.
//!
//! `cargo bench -p backlot-engine --no-default-features --bench kernels`.

use std::hint::black_box;

use backlot_engine::backend::cpu::kernels::{GridKernels, NetworkKernels};
use criterion::{Criterion, Throughput, criterion_group, criterion_main};

/// A block of rays as training has them.
const BLOCK: (usize, usize) = (32, 12);

fn network(c: &mut Criterion) {
    for (form, exact) in [("f32", true), ("fastest", false)] {
        for width in [32, 64, 128] {
            let mut kernels = NetworkKernels::new(width, BLOCK, exact);
            let mut group = c.benchmark_group(format!("network {form} {width}"));
            group.throughput(Throughput::Elements(kernels.sample_count() as u64));
            group.bench_function("forward, samples", |b| b.iter(|| kernels.forward()));
            group.bench_function("backward, samples", |b| b.iter(|| kernels.backward()));
            group.finish();
        }
    }
}

fn grid(c: &mut Criterion) {
    let mut kernels = GridKernels::new(160, 1 << 17);
    let mut group = c.benchmark_group("dense grid 160^3");
    group.throughput(Throughput::Elements(kernels.point_count() as u64));
    group.bench_function("trilinear gather of 12 features, samples", |b| {
        b.iter(|| black_box(kernels.gather()));
    });
    group.sample_size(10);
    group.bench_function("scatter and masked Adam, samples", |b| {
        b.iter(|| kernels.scatter_and_step());
    });
    group.finish();
}

criterion_group!(benches, network, grid);
criterion_main!(benches);
