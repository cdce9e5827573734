//! Fits a radiance field to a scene in the NeRF-synthetic layout and measures it on the test views.
//!
//! `cargo run --release -p backlot-engine --example fit -- SCENE_DIR --preset fast --budget-s 120 --json OUT.json`

mod dataset;
mod measure;

use std::num::NonZeroUsize;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Mutex;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, ensure};
use backlot_engine::Field;
use backlot_engine::backend::{self, DeviceChoice};
use backlot_engine::train::{
    BoundedInput, DvgoRecipe, Progress, TrainControl, TrainPreset, Trained, frustum_box, seen_box,
    train_bounded, train_dvgo,
};
use backlot_engine::view::TrainView;
use clap::{Parser, ValueEnum};

use measure::{Moment, Report, peak_rss_mib, test_figures};

/// Seconds of training from which on the test views are looked at, each half as late again as the one before.
const FIRST_LOOK_S: f64 = 2.0;
const LOOK_GROWTH: f64 = 1.25;
const WHITE: [f32; 3] = [1.0; 3];

#[derive(Parser)]
struct Arguments {
    /// Folder with transforms_train.json, transforms_test.json and the PNGs they name.
    scene: PathBuf,
    #[arg(long, value_enum, default_value = "fast")]
    preset: Preset,
    /// Train for this many seconds, evaluation not counted.
    #[arg(long, conflicts_with = "iters")]
    budget_s: Option<f64>,
    /// Train for this many steps.
    #[arg(long)]
    iters: Option<u64>,
    /// Rays of a step, in place of the preset's: few suit a small or a software device.
    #[arg(long)]
    rays: Option<NonZeroUsize>,
    /// Threads to train and render with; by default one per processor.
    #[arg(long, default_value_t = 0)]
    threads: usize,
    /// Where to train: auto, cpu, gpu, gpu:NUMBER or gpu:NAME.
    #[arg(long, default_value_t = DeviceChoice::Auto)]
    device: DeviceChoice,
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Where to write the figures.
    #[arg(long)]
    json: Option<PathBuf>,
    /// Folder for the rendered test views, r_K.png.
    #[arg(long)]
    out: Option<PathBuf>,
}

#[derive(Clone, Copy, ValueEnum)]
enum Preset {
    /// The fastest way to a good field.
    Fast,
    /// DVGO's recipe with its own counts: --budget-s does not shorten it, and --iters, the fine stage's steps, scales every
    /// count of steps alike.
    Dvgo,
}

fn main() -> ExitCode {
    match run(&Arguments::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::from(2)
        }
    }
}

fn run(arguments: &Arguments) -> Result<()> {
    if let Some(seconds) = arguments.budget_s {
        ensure!(seconds > 0.0, "--budget-s must be positive");
    }
    rayon::ThreadPoolBuilder::new()
        .num_threads(arguments.threads)
        .build_global()
        .context("--threads: the thread pool cannot start")?;
    let scene = dataset::read(&arguments.scene)?;
    let watch = Watch::new(&scene.test);
    let trained = train(arguments, scene.train, &watch)?;
    let figures = test_figures(&trained.field, &scene.test, WHITE);
    if let Some(folder) = &arguments.out {
        figures.write(folder)?;
    }
    let state = watch.state.into_inner().expect("no thread panicked");
    let train_s = trained.quality.train_seconds;
    let mut progress = state.moments;
    progress.push(Moment {
        train_s,
        psnr_test: figures.psnr,
    });
    let report = Report {
        train_s,
        iters: state.steps,
        rays: trained.quality.train_rays,
        rays_per_s: trained.quality.train_rays as f64 / train_s,
        psnr_test: figures.psnr,
        ssim_test: figures.ssim,
        render_ms_per_frame: figures.ms_per_frame,
        peak_rss_mib: peak_rss_mib(),
        field_mib: trained.field.memory_bytes() as f64 / (1u64 << 20) as f64,
        progress,
    };
    let text = serde_json::to_string_pretty(&report)?;
    match &arguments.json {
        Some(path) => std::fs::write(path, text)
            .with_context(|| format!("{}: cannot be written", path.display()))?,
        None => println!("{text}"),
    }
    Ok(())
}

fn train(arguments: &Arguments, views: Vec<TrainView>, watch: &Watch<'_>) -> Result<Trained> {
    let (low_m, high_m) = match arguments.preset {
        Preset::Fast => seen_box(&views)?,
        Preset::Dvgo => frustum_box(&views)?,
    };
    let input = BoundedInput {
        views,
        low_m,
        high_m,
        backdrop: WHITE,
    };
    let seed = arguments.seed;
    let backend = backend::open(&arguments.device, 0)?;
    eprintln!("training on {}", backend.device());
    let trained = match arguments.preset {
        Preset::Fast => {
            let preset = fast(arguments, &input.views, (high_m - low_m).max_element());
            train_bounded(&input, &preset, seed, backend.as_ref(), watch)?
        }
        Preset::Dvgo => train_dvgo(&input, &dvgo(arguments), seed, backend.as_ref(), watch)?,
    };
    Ok(trained)
}

fn fast(arguments: &Arguments, views: &[TrainView], edge_m: f64) -> TrainPreset {
    // All views have about the same distance to the scene; the first stands for them.
    let view = &views[0];
    let distance_m = view.local_from_camera.translation_m.length();
    let mut preset = TrainPreset::fast(edge_m, distance_m / view.camera.focal_px.x);
    if let Some(steps) = arguments.iters {
        preset.steps = steps;
    }
    if let Some(rays) = arguments.rays {
        preset.mix.pixel_rays = rays.get();
    }
    if let Some(seconds) = arguments.budget_s {
        preset.seconds = seconds;
        preset.steps = u64::MAX;
    }
    preset
}

fn dvgo(arguments: &Arguments) -> DvgoRecipe {
    let recipe = arguments.iters.map(DvgoRecipe::scaled);
    let mut recipe = recipe.unwrap_or_default();
    if let Some(rays) = arguments.rays {
        (recipe.coarse.rays, recipe.fine.rays) = (rays.get(), rays.get());
    }
    recipe
}

/// Looks at the test views now and then, on a clock that stands still meanwhile.
struct Watch<'a> {
    views: &'a [TrainView],
    start: Instant,
    state: Mutex<WatchState>,
}

struct WatchState {
    away: Duration,
    next_s: f64,
    steps: u64,
    moments: Vec<Moment>,
}

impl<'a> Watch<'a> {
    fn new(views: &'a [TrainView]) -> Self {
        Self {
            views,
            start: Instant::now(),
            state: Mutex::new(WatchState {
                away: Duration::ZERO,
                next_s: FIRST_LOOK_S,
                steps: 0,
                moments: Vec::new(),
            }),
        }
    }
}

impl TrainControl for Watch<'_> {
    fn progress(&self, _: Progress) {}

    fn looks(&self, progress: Progress) -> bool {
        let train_s = self.seconds();
        let mut state = self.state.lock().expect("no thread panicked");
        state.steps = progress.step;
        // The finished field is looked at once, by the caller.
        train_s >= state.next_s && progress.step < progress.step_count
    }

    fn inspect(&self, progress: Progress, field: &Field) {
        let train_s = self.seconds();
        let mut state = self.state.lock().expect("no thread panicked");
        state.steps = progress.step;
        let looking = Instant::now();
        let psnr_test = test_figures(field, self.views, WHITE).psnr;
        eprintln!(
            "{train_s:7.1} s  step {:6}  train {:5.2} dB  test {psnr_test:5.2} dB",
            progress.step,
            progress.psnr_train.unwrap_or(f64::NAN)
        );
        state.moments.push(Moment { train_s, psnr_test });
        state.next_s = train_s * LOOK_GROWTH;
        state.away += looking.elapsed();
    }

    fn cancelled(&self) -> bool {
        false
    }

    fn seconds(&self) -> f64 {
        let away = self.state.lock().expect("no thread panicked").away;
        (self.start.elapsed() - away).as_secs_f64()
    }
}
