//! `backlot demo`: the whole path once, with an embedded server.

mod source;

mod library;
mod recipes;
mod stages;

mod exact;
mod figures;
mod held_out;
mod held_out_objects;
mod sheet;

mod machine;
mod report;

use std::collections::BTreeMap;
use std::net::{Ipv4Addr, SocketAddr};
use std::path::Path;
use std::time::Duration;

use anyhow::{Context, ensure};
use backlot_client::Connection;
use backlot_client::labels::origin_name;
use backlot_client::sample_files::{LabelFormat, SampleFiles};
use backlot_proto::v1;
use backlot_server::config::Config;
use backlot_server::server::Server;

use crate::args::{Budget, DemoOptions};
use crate::{augment, jobs, output};
use exact::ExactComparison;
use library::Library;
use report::{Findings, Report};
use source::Source;
use stages::Stages;

/// Time that calls and jobs get when the demo ends; none should be running.
const SHUTDOWN_GRACE: Duration = Duration::from_secs(5);

pub(crate) async fn run(options: &DemoOptions) -> anyhow::Result<()> {
    ensure!(options.count > 0, "--count must be at least 1");
    std::fs::create_dir_all(&options.out)
        .with_context(|| format!("creating {}", options.out.display()))?;
    let mut stages = Stages::default();
    let source = stages.time_blocking("read", || Source::open(options))?;
    if source.street.is_some() {
        eprintln!("note: the log is generated: a synthetic, ray-traced street");
    }
    let listen = SocketAddr::from((Ipv4Addr::LOCALHOST, 0));
    let config = Config {
        device: options.device.clone(),
        ..Config::new(options.out.join("store"), listen)
    };
    let server = stages.time("start", Server::start(config)).await?;
    let url = format!("http://{}", server.local_addr());
    eprintln!(
        "server: {url}, store in {}",
        options.out.join("store").display()
    );
    let connection = Connection::open(&url).await?;
    let result = run_against(&connection, options, &source, &mut stages).await;
    server.shutdown(SHUTDOWN_GRACE).await;
    result
}

async fn run_against(
    connection: &Connection,
    options: &DemoOptions,
    source: &Source,
    stages: &mut Stages,
) -> anyhow::Result<()> {
    stages
        .time("upload", library::upload(connection, source))
        .await?;
    let (library, mut notes) = train(connection, options, source, stages).await?;
    notes.splice(0..0, source.log.drive_log.notes.clone());
    let samples = stages
        .time(
            "samples",
            render_samples(connection, options, source, &library),
        )
        .await?;
    let held_out = stages
        .time(
            "held_out",
            held_out::measure(connection, source, &library, &options.out),
        )
        .await?;
    let object_psnr = stages
        .time(
            "held_out_objects",
            measure_objects(connection, source, &library, &options.out),
        )
        .await?;
    let exact = stages.time_blocking("exact", || {
        compare_with_exact(source, &library, &samples, &options.out)
    })?;
    stages.time_blocking("contact_sheet", || {
        sheet::write(source, &samples, &exact, &options.out)
    })?;
    let report = Report::new(Findings {
        log: &source.log.drive_log,
        library: &library,
        held_out,
        object_psnr,
        samples: &samples,
        exact,
        stages,
        notes,
    });
    report.write(&options.out.join("report.json"))?;
    summarise(&report, &options.out);
    Ok(())
}

/// Trains the background and the objects; returns what the jobs warned of as well.
async fn train(
    connection: &Connection,
    options: &DemoOptions,
    source: &Source,
    stages: &mut Stages,
) -> anyhow::Result<(Library, Vec<String>)> {
    let default = if source.street.is_some() {
        Budget::Quick
    } else {
        Budget::Standard
    };
    let budget = jobs::wire_budget(options.budget.unwrap_or(default));
    let job = |kind| library::train(connection, &source.name, kind, budget, options.seed);
    let (background_job, backgrounds) = stages
        .time("background", job(v1::JobKind::Background))
        .await?;
    let (objects_job, objects) = stages.time("objects", job(v1::JobKind::Objects)).await?;
    let supplied = if source.street.is_none() {
        let supply = library::supply(connection, &objects, options.seed);
        stages.time("supply", supply).await?
    } else {
        Vec::new()
    };
    let mut notes = background_job.warnings;
    notes.extend(objects_job.warnings.clone());
    if !supplied.is_empty() {
        notes
            .push("objects of a generated (synthetic) street were added to the library".to_owned());
    }
    let library = Library {
        background: library::only_background(backgrounds)?,
        moving: library::moving_tracks(&objects_job),
        objects,
        supplied,
    };
    Ok((library, notes))
}

/// Streams the samples into files; the returned ones are without images.
async fn render_samples(
    connection: &Connection,
    options: &DemoOptions,
    source: &Source,
    library: &Library,
) -> anyhow::Result<Vec<v1::Sample>> {
    let placeable = library.placeable();
    if placeable.is_empty() {
        eprintln!("warning: no object may be placed freely; the samples show the originals only");
    }
    let recorded = source.street.is_none();
    let base = v1::Recipe {
        background: library.background.name.clone(),
        objects: placeable.iter().map(|asset| asset.name.clone()).collect(),
        sun_direction_world: options
            .sun
            .as_deref()
            .map(augment::sun_direction)
            .transpose()?,
        ..Default::default()
    };
    let mut files = SampleFiles::new(&options.out, &[LabelFormat::Kitti, LabelFormat::Json]);
    let mut samples: Vec<v1::Sample> = Vec::new();
    for (recipe, count) in recipes::recipes(&base, library, recorded, options.count) {
        let request = v1::StreamSamplesRequest {
            recipe: Some(recipe),
            seed: options.seed,
            start_index: samples.len() as u64,
            count,
        };
        let streamed = augment::stream(connection, request, |sample| {
            Ok(files.write(sample).map(|_| ())?)
        });
        samples.extend(streamed.await?);
    }
    let provenance = samples.first().and_then(|sample| sample.provenance.clone());
    files.write_index(&provenance.unwrap_or_default())?;
    Ok(samples)
}

/// Held-out PSNR of the log's own objects by asset, from written files; empty for a recorded log, which has no exact masks.
async fn measure_objects(
    connection: &Connection,
    source: &Source,
    library: &Library,
    out: &Path,
) -> anyhow::Result<BTreeMap<String, f64>> {
    let mut measured = BTreeMap::new();
    let Some(street) = &source.street else {
        return Ok(measured);
    };
    for asset in &library.objects {
        let psnr = held_out_objects::measure(connection, source, street, asset, out).await?;
        measured.extend(psnr.map(|psnr| (asset.name.clone(), psnr)));
    }
    Ok(measured)
}

fn compare_with_exact(
    source: &Source,
    library: &Library,
    samples: &[v1::Sample],
    out: &Path,
) -> anyhow::Result<Vec<ExactComparison>> {
    let Some(street) = &source.street else {
        return Ok(Vec::new());
    };
    samples
        .iter()
        .map(|sample| exact::compare(street, library, sample, out))
        .collect()
}

/// Boxes of a sample by origin.
fn sample_boxes(sample: &v1::Sample) -> BTreeMap<&'static str, u32> {
    let mut boxes = BTreeMap::new();
    for placed in &sample.boxes_3d {
        *boxes.entry(origin_name(placed.origin())).or_default() += 1;
    }
    boxes
}

fn summarise(report: &Report, out: &Path) {
    let figure = |value, digits| output::figure(value, digits);
    let background = &report.background;
    println!(
        "background  {} dB held out ({} dB warped neighbour), depth error {} m against {}",
        figure(background.psnr_held_out, 2),
        figure(background.psnr_warp_baseline, 2),
        figure(background.depth_mae_m, 3),
        background.depth_mae_against,
    );
    for object in &report.objects {
        println!(
            "object      {} dB held out, {} {} of {} ({})",
            figure(object.psnr_held_out, 2),
            object.class,
            object.track,
            object.source_log,
            object.usage,
        );
    }
    println!(
        "samples     {} with {} placements; against exact: {} dB whole, {} dB inserts, mask IoU {}, box IoU {}",
        report.samples,
        report.placements.accepted,
        figure(report.sample_psnr_vs_exact, 2),
        figure(report.insert_psnr_vs_exact, 2),
        figure(report.insert_mask_iou_median, 3),
        figure(report.visible_box_iou_median, 3),
    );
    println!(
        "cost        {:.0} s, {} CPU s, {} MiB at most",
        report.total_seconds,
        figure(report.cpu_seconds, 0),
        figure(report.peak_rss_mib, 0),
    );
    println!("look at     {}", out.join("contact_sheet.png").display());
}
