//! How soon a cancelled call ends: what the device is given between two questions, and that it is given nothing after a yes.

use std::sync::{Arc, Mutex};

use super::adapter::{on_adapter, open};
use super::street::{Street, camera};
use crate::Error;
use crate::backend::cpu::tests::{LOSSES, field, rays_of_all_sorts};
use crate::backend::gpu::transfer::NODES_PER_COPY;
use crate::backend::gpu::{GpuBackend, GpuTrainer};
use crate::backend::{Backend, bench_scene};
use crate::camera::Distortion;
use crate::field::BRICK_NODES;
use crate::scene::{RenderOptions, Scene};
use crate::train::ray::Rates;

const RATES: Rates = Rates {
    density: 0.02,
    features: 0.02,
    mlp: 2e-3,
    sky: 0.05,
    exposure: 0.01,
    pose_m: 1e-3,
};
/// Kernels of the longest submission, the backward pass of a batch.
const KERNELS: u64 = 8;

/// Asks of a call that is cancelled at number `stop`, and kernels dispatched when each was asked.
#[derive(Default)]
struct Asked {
    dispatched: Mutex<Vec<u64>>,
    stop: Option<usize>,
}

impl Asked {
    fn answer(&self, gpu: &GpuBackend) -> bool {
        let mut dispatched = self.dispatched.lock().expect("no panic");
        dispatched.push(gpu.dispatch_count());
        self.stop == Some(dispatched.len() - 1)
    }

    fn counts(self) -> Vec<u64> {
        self.dispatched.into_inner().expect("no panic")
    }
}

/// # Errors
/// Names the questions between which too much was dispatched.
fn little_between(counts: &[u64]) -> Result<(), String> {
    for (number, pair) in counts.windows(2).enumerate() {
        if pair[1] - pair[0] > KERNELS {
            return Err(format!(
                "{} kernels after question {number}",
                pair[1] - pair[0]
            ));
        }
    }
    Ok(())
}

/// A device of its own: others would dispatch on the shared one.
#[test]
fn parity_of_cancelled_steps_which_dispatch_nothing_more() {
    on_adapter("cancelled steps", |shared| {
        let gpu = open().expect("opens");
        let rays = rays_of_all_sorts(200);
        let step = |asked: &Asked| {
            let mut trainer = gpu.open_trainer(field(), &|| false).expect("fits");
            trainer.batches_of(16);
            let cancelled = || asked.answer(&gpu);
            trainer.step(&rays, &LOSSES, RATES, 0.5, &cancelled)
        };
        let asked = Asked::default();
        step(&asked).expect("nobody cancels");
        let counts = asked.counts();
        // Thirteen batches of two submissions, the sums, one slice of the bricks, the rest.
        assert_eq!(counts.len(), 2 * 13 + 3);
        little_between(&counts).expect("short submissions");
        let mut longer = counts.clone();
        longer.remove(3);
        assert!(little_between(&longer).is_err(), "a question less passes");
        for stop in [0, 1, 12, counts.len() - 1] {
            let asked = Asked {
                stop: Some(stop),
                ..Asked::default()
            };
            let stopped = step(&asked);
            assert!(matches!(stopped, Err(Error::Cancelled)), "{stopped:?}");
            let counts = asked.counts();
            assert_eq!(counts.len(), stop + 1, "asked again after a yes");
            assert_eq!(counts[stop], gpu.dispatch_count(), "dispatched after a yes");
        }
        let mut trainer = shared.open_trainer(field(), &|| false).expect("fits");
        trainer
            .step(&rays, &LOSSES, RATES, 0.0, &|| false)
            .expect("works");
    });
}

/// # Errors
/// Tells how often an upload of this many nodes was asked about, if that is too seldom.
fn asked_for_every_piece(asks: usize, nodes: usize) -> Result<(), String> {
    // Densities and three quads of features.
    let pieces = 4 * nodes.div_ceil(NODES_PER_COPY);
    if asks < pieces {
        return Err(format!("{asks} questions, {pieces} pieces"));
    }
    Ok(())
}

#[test]
fn parity_of_cancelled_uploads_which_write_nothing_more() {
    on_adapter("cancelled uploads", |shared| {
        let gpu = open().expect("opens");
        let background = Arc::new(bench_scene::field(16));
        let nodes = background.levels()[0].density().len() - BRICK_NODES;
        let street = Street::new();
        let scene = Scene {
            background: Some(&background),
            ..street.scene(camera(Distortion::None).resized(62, 19))
        };
        let options = RenderOptions::default();
        for stop in [0, 1, 9, 4 * nodes.div_ceil(NODES_PER_COPY) - 1] {
            let before = gpu.dispatch_count();
            let asked = Asked {
                stop: Some(stop),
                ..Asked::default()
            };
            let stopped = gpu.render(&scene, &options, &|| asked.answer(&gpu));
            assert!(matches!(stopped, Err(Error::Cancelled)), "{stopped:?}");
            assert_eq!(asked.counts().len(), stop + 1, "asked again after a yes");
            assert_eq!(
                gpu.dispatch_count(),
                before,
                "{stop}: it was uploaded by then"
            );
            assert_eq!(gpu.resident_bytes(), 0, "{stop}: something is kept");
        }
        let asked = Asked::default();
        let before = gpu.dispatch_count();
        let whole = gpu.render(&scene, &options, &|| asked.answer(&gpu));
        whole.expect("nobody cancels");
        assert!(gpu.resident_bytes() > 100 << 20);
        let counts = asked.counts();
        let asks = counts.iter().filter(|count| **count == before).count();
        asked_for_every_piece(asks, nodes).expect("short pieces");
        // Broken: an upload in one go asks before the first kernel alone.
        assert!(asked_for_every_piece(1, nodes).is_err());
        let small = street.scene(camera(Distortion::None).resized(62, 19));
        let rendered = shared.render(&small, &options, &|| false);
        rendered.expect("renders");
    });
}

/// A field of 35 bricks a side takes some pieces of every kind of value, up and down.
#[test]
fn parity_of_trainers_that_are_cancelled_while_they_open_or_fetch() {
    on_adapter("cancelled trainers", |shared| {
        let gpu = open().expect("opens");
        let large = bench_scene::field(16);
        let nodes = large.levels()[0].density().len() - BRICK_NODES;
        let open_at = |stop: Option<usize>| {
            let asked = Asked {
                stop,
                ..Asked::default()
            };
            let opened = gpu.open_trainer(large.clone(), &|| asked.answer(&gpu));
            (opened, asked.counts().len())
        };
        let (opened, asks) = open_at(None);
        let mut trainer = opened.expect("fits");
        // Densities, three quads of features, and the mean squares of both together.
        asked_for_every_piece(asks, nodes).expect("short pieces");
        for stop in [0, 1, asks - 1] {
            let (stopped, asks) = open_at(Some(stop));
            let error = stopped.expect_err("was cancelled");
            assert_eq!(error, crate::backend::gpu::Error::Cancelled);
            assert_eq!(asks, stop + 1, "asked again after a yes");
        }
        let fetch_at = |trainer: &mut GpuTrainer, stop: Option<usize>| {
            let asked = Asked {
                stop,
                ..Asked::default()
            };
            let fetched = trainer.fetch(&|| asked.answer(&gpu));
            (fetched, asked.counts().len())
        };
        let (fetched, asks) = fetch_at(&mut trainer, None);
        fetched.expect("nobody cancels");
        assert_eq!(asks, nodes.div_ceil(NODES_PER_COPY));
        for stop in [0, asks - 1] {
            let (stopped, asks) = fetch_at(&mut trainer, Some(stop));
            assert_eq!(stopped, Err(crate::backend::gpu::Error::Cancelled));
            assert_eq!(asks, stop + 1, "asked again after a yes");
        }
        // Broken: one question in all.
        assert!(asked_for_every_piece(1, nodes).is_err());
        let mut small = shared.open_trainer(field(), &|| false).expect("fits");
        let rays = rays_of_all_sorts(16);
        small
            .step(&rays, &LOSSES, RATES, 0.0, &|| false)
            .expect("works");
    });
}

#[test]
fn parity_of_cancelled_frames_which_dispatch_nothing_more() {
    on_adapter("cancelled frames", |shared| {
        let gpu = open().expect("opens");
        let street = Street::new();
        let scene = street.scene(camera(Distortion::None).resized(124, 37));
        let options = RenderOptions::default();
        // What is asked while assets are uploaded is another test.
        gpu.render(&scene, &options, &|| false).expect("renders");
        let asked = Asked::default();
        let frame = gpu.render(&scene, &options, &|| asked.answer(&gpu));
        frame.expect("nobody cancels");
        let asks = asked.counts().len();
        assert!(asks > 3, "a frame of {asks} batches");
        for stop in [0, 1, asks - 1] {
            let asked = Asked {
                stop: Some(stop),
                ..Asked::default()
            };
            let stopped = gpu.render(&scene, &options, &|| asked.answer(&gpu));
            // Paces differ from run to run: the last question of one may not be asked in another.
            if stopped.is_ok() {
                assert!(stop > 1 && asked.counts().len() <= stop, "not heeded");
                continue;
            }
            assert!(matches!(stopped, Err(Error::Cancelled)), "{stopped:?}");
            let counts = asked.counts();
            assert_eq!(counts.len(), stop + 1, "asked again after a yes");
            assert_eq!(counts[stop], gpu.dispatch_count(), "dispatched after a yes");
        }
        let whole = shared.render(&scene, &options, &|| false);
        whole.expect("renders");
    });
}
