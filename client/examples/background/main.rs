//! Trains the background of a generated street at the paper's scale and says how good it is at which time.
//!
//! `cargo run --release -p backlot-client --example background -- --preset standard --train-s 600 --looks-s 300,600`

mod clock;
mod measure;
mod seen;

use std::path::{Path, PathBuf};
use std::sync::Mutex;

use anyhow::{Context, Result, bail, ensure};
use backlot_client::generator::{LidarConfig, StreetConfig, StreetWorld};
use backlot_engine::backend::cpu::CpuBackend;
use backlot_engine::train::{
    BackgroundInput, Budget, Progress, Stage, TrainControl, TrainPreset, train_background,
};
use backlot_engine::{Asset, Field};
use backlot_server::api::convert_drive_log::drive_log_from_wire;
use backlot_server::ingest::{LogLabels, background_set};
use clap::{Parser, ValueEnum};

use clock::{Clock, Source};
use measure::{HeldOut, Moment, Report, peak_rss_mib, stored};

#[derive(Parser)]
struct Arguments {
    #[arg(long, value_enum, default_value = "standard")]
    preset: Preset,
    /// Seconds of training, which the schedule is stretched over; without it the preset's own steps are taken.
    #[arg(long)]
    train_s: Option<f64>,
    /// Seconds of training at which the held-out frames are looked at.
    #[arg(long, value_delimiter = ',')]
    looks_s: Vec<f64>,
    /// What a second is: of the wall, or of this process's processor time divided by the threads, which other load on the
    /// machine lengthens little.
    #[arg(long, value_enum, default_value = "wall")]
    clock: Source,
    #[arg(long, default_value_t = 2)]
    threads: usize,
    #[arg(long, default_value_t = 35)]
    frames: u32,
    #[arg(long, default_value_t = 150.0)]
    travel_m: f64,
    #[arg(long, default_value_t = 960)]
    width: u32,
    #[arg(long, default_value_t = 640)]
    height: u32,
    /// Half the sector around straight ahead that the scanner records; a whole turn as the scanners of cars do.
    #[arg(long, default_value_t = 180.0)]
    lidar_sector_deg: f64,
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// One frame in so many is held out.
    #[arg(long, default_value_t = 8)]
    hold_out_every: usize,
    /// Where to write the figures.
    #[arg(long)]
    json: Option<PathBuf>,
    /// Measures the asset stored in this file instead of training one.
    #[arg(long, conflicts_with_all = ["train_s", "looks_s", "asset", "json"])]
    from: Option<PathBuf>,
    /// Where to write the asset.
    #[arg(long)]
    asset: Option<PathBuf>,
    /// Folder for the held-out frames beside what the field shows.
    #[arg(long)]
    out: Option<PathBuf>,
}

#[derive(Clone, Copy, ValueEnum)]
enum Preset {
    Quick,
    Standard,
    /// The paper's dense box.
    Paper,
}

fn main() -> Result<()> {
    let arguments = Arguments::parse();
    ensure!(arguments.threads > 0, "--threads must be positive");
    rayon::ThreadPoolBuilder::new()
        .num_threads(arguments.threads)
        .build_global()?;
    let (world, input) = street(&arguments)?;
    let held_out = HeldOut::new(&world, &input.views)?;
    if let Some(path) = &arguments.from {
        return measure_stored(path, &held_out, arguments.out.as_deref());
    }
    let preset = preset(&arguments)?;
    let pixels: usize = input.views.iter().map(|v| v.camera.pixel_count()).sum();
    eprintln!(
        "{} frames, {pixels} pixels, {} returns, {} beams",
        input.views.len(),
        input.lidar_points.len(),
        input.beams.len()
    );
    let watch = Watch::new(&arguments, &held_out);
    let trained = train_background(&input, &preset, arguments.seed, &CpuBackend, &watch)?;
    let train_s = trained.quality.train_seconds;
    let rss_mib = peak_rss_mib();
    let psnr_seen = held_out.psnr(&trained.field).seen;
    let state = watch.state.into_inner().expect("no thread panicked");
    let report = Report {
        train_s,
        steps: state.steps,
        rays: trained.quality.train_rays,
        psnr_held_out: trained.quality.psnr_held_out,
        psnr_seen,
        ssim_held_out: trained.quality.ssim_held_out,
        depth_mae_m: trained.quality.depth_mae_m,
        psnr_train: trained.quality.psnr_train,
        peak_rss_mib: rss_mib,
        field_mib: trained.field.memory_bytes() as f64 / f64::from(1 << 20),
        voxel_size_m: trained.quality.voxel_size_m,
        warnings: trained.quality.warnings.clone(),
        progress: state.moments,
        asset_mb: None,
        psnr_stored: None,
    };
    if let Some(folder) = &arguments.out {
        held_out.write(&trained.field, folder)?;
    }
    let payload = stored(trained);
    if let Some(path) = &arguments.asset {
        std::fs::write(path, &payload)
            .with_context(|| format!("{}: cannot be written", path.display()))?;
    }
    let read_back = Asset::decode(&payload)?;
    let report = Report {
        asset_mb: Some(payload.len() as f64 / 1e6),
        psnr_stored: Some(held_out.psnr(&read_back.field).all),
        ..report
    };
    let text = serde_json::to_string_pretty(&report)?;
    match &arguments.json {
        Some(path) => std::fs::write(path, text)
            .with_context(|| format!("{}: cannot be written", path.display()))?,
        None => println!("{text}"),
    }
    Ok(())
}

/// The street's log, decomposed as a job would, at full resolution.
fn street(arguments: &Arguments) -> Result<(StreetWorld, BackgroundInput)> {
    let config = StreetConfig {
        seed: arguments.seed,
        frames: arguments.frames,
        width: arguments.width,
        height: arguments.height,
        travel_m: arguments.travel_m,
        lidar: LidarConfig {
            half_sector_rad: arguments.lidar_sector_deg.to_radians(),
            ..LidarConfig::default()
        },
        parked_cars: StreetConfig::parked_along(arguments.travel_m),
        ..StreetConfig::default()
    };
    let world = StreetWorld::new(&config)?;
    let mut log = world.read_log()?;
    log.drive_log.name = "driveLogs/street".to_owned();
    let drive_log = match drive_log_from_wire(log.drive_log.clone()) {
        Ok(drive_log) => drive_log,
        Err(violations) => bail!("the generated log is not valid: {violations:?}"),
    };
    let every = arguments.hold_out_every;
    let labels = LogLabels::default();
    let set = background_set(&drive_log, &log, &labels, every, u32::MAX, |_, _| true)?;
    Ok((world, set.expect("nothing stops it").input))
}

fn measure_stored(path: &Path, held_out: &HeldOut, out: Option<&Path>) -> Result<()> {
    let payload =
        std::fs::read(path).with_context(|| format!("{}: cannot be read", path.display()))?;
    let asset = Asset::decode(&payload)?;
    let psnr = held_out.psnr(&asset.field);
    println!(
        "held out {:.2} dB, of what was seen {:.2} dB",
        psnr.all, psnr.seen
    );
    match out {
        Some(folder) => held_out.write(&asset.field, folder),
        None => Ok(()),
    }
}

fn preset(arguments: &Arguments) -> Result<TrainPreset> {
    let mut preset = TrainPreset::background(match arguments.preset {
        Preset::Quick => Budget::Quick,
        Preset::Standard => Budget::Standard,
        Preset::Paper => Budget::Paper,
    });
    if let Some(seconds) = arguments.train_s {
        ensure!(seconds > 0.0, "--train-s must be positive");
        preset.seconds = seconds;
        preset.steps = u64::MAX;
        preset.most_passes = f64::INFINITY;
    }
    Ok(preset)
}

/// Looks at the held-out frames at the asked moments, on a clock that stands still meanwhile.
struct Watch<'a> {
    held_out: &'a HeldOut<'a>,
    clock: Clock,
    looks_s: &'a [f64],
    state: Mutex<State>,
}

#[derive(Default)]
struct State {
    away_s: f64,
    looked: usize,
    steps: u64,
    moments: Vec<Moment>,
}

impl<'a> Watch<'a> {
    fn new(arguments: &'a Arguments, held_out: &'a HeldOut<'a>) -> Self {
        Self {
            held_out,
            clock: Clock::start(arguments.clock, arguments.threads),
            looks_s: &arguments.looks_s,
            state: Mutex::default(),
        }
    }
}

impl TrainControl for Watch<'_> {
    fn progress(&self, progress: Progress) {
        if progress.stage == Stage::Train && progress.step.is_multiple_of(500) {
            let psnr = progress.psnr_train.unwrap_or(f64::NAN);
            let train_s = self.seconds();
            eprintln!(
                "{train_s:7.1} s  step {:6}  train {psnr:5.2} dB",
                progress.step
            );
        }
    }

    fn looks(&self, progress: Progress) -> bool {
        let train_s = self.seconds();
        let mut state = self.state.lock().expect("no thread panicked");
        state.steps = progress.step;
        self.looks_s.iter().filter(|at| train_s >= **at).count() > state.looked
    }

    fn inspect(&self, _: Progress, field: &Field) {
        let train_s = self.seconds();
        let mut state = self.state.lock().expect("no thread panicked");
        state.looked = self.looks_s.iter().filter(|at| train_s >= **at).count();
        let before_s = self.clock.seconds();
        let psnr = self.held_out.psnr(field);
        let peak_rss_mib = peak_rss_mib();
        eprintln!(
            "{train_s:7.1} s  held out {:5.2} dB, seen {:5.2} dB  {peak_rss_mib:.0} MiB",
            psnr.all, psnr.seen
        );
        state.moments.push(Moment {
            train_s,
            psnr_held_out: psnr.all,
            psnr_seen: psnr.seen,
        });
        state.away_s += self.clock.seconds() - before_s;
    }

    fn cancelled(&self) -> bool {
        false
    }

    fn seconds(&self) -> f64 {
        let away_s = self.state.lock().expect("no thread panicked").away_s;
        self.clock.seconds() - away_s
    }
}
