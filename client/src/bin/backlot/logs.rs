//! `backlot logs`.

use std::time::Instant;

use anyhow::Context;
use backlot_client::geometry::{rigid_from_wire, vector_from_wire};
use backlot_client::upload::upload_log;
use backlot_client::{Connection, listing, names};
use backlot_proto::v1;
use serde::Serialize;

use crate::args::{LogsCommand, Output, UploadOptions};
use crate::input::LogSource;
use crate::output::{self, Row};
use crate::{input, inspect, progress::Progress, tracks};

pub(crate) async fn run(
    open: &impl AsyncFn() -> backlot_client::Result<Connection>,
    command: LogsCommand,
    output: Output,
) -> anyhow::Result<()> {
    match command {
        LogsCommand::Upload(options) => upload(open, &options, output).await,
        LogsCommand::Inspect(options) => inspect::run(&options, output),
        LogsCommand::List => {
            let summaries = listing::drive_logs(&open().await?).await?;
            let rows: Vec<_> = summaries.into_iter().map(LogRow::from_summary).collect();
            output::print(output, &rows)
        }
        LogsCommand::Show { log, tracks: false } => show(&open().await?, &log, output).await,
        LogsCommand::Show { log, tracks: true } => {
            let name = names::drive_log(&log)?;
            tracks::show(&open().await?, &name, output).await
        }
        LogsCommand::Delete { log } => {
            let name = names::drive_log(&log)?;
            let connection = open().await?;
            let request = v1::DeleteDriveLogRequest { name: name.clone() };
            let reply = connection.drive_logs().delete_drive_log(request).await;
            reply.map_err(|status| backlot_client::Error::from_status("deleting", status))?;
            eprintln!("{name} deleted");
            Ok(())
        }
    }
}

async fn upload(
    open: &impl AsyncFn() -> backlot_client::Result<Connection>,
    options: &UploadOptions,
    output: Output,
) -> anyhow::Result<()> {
    let name = names::drive_log(&options.name)?;
    let started = Instant::now();
    let log = input::read(&LogSource {
        path: options.path.as_deref(),
        format: options.format,
        parts: &options.parts,
        seed: options.seed,
        street: &options.street,
    })?;
    let reading = started.elapsed();
    let connection = open().await?;
    let progress = Progress::bytes("upload");
    let progress_cell = std::sync::Mutex::new(progress);
    let uploaded = upload_log(&connection, &log, &name, &|bytes| {
        if let Ok(progress) = progress_cell.lock() {
            progress.set_bytes(bytes);
        }
    })
    .await?;
    let (sent, total) = (uploaded.blobs_sent, uploaded.blobs_total);
    if let Ok(progress) = progress_cell.into_inner() {
        progress.finish(&format!(
            "{sent} of {total} blobs were sent, the rest was there: {:.1} MB; read in {:.1} s, sent in {:.1} s, accepted in {:.1} s",
            uploaded.bytes_sent as f64 / 1e6,
            reading.as_secs_f64(),
            uploaded.sending.as_secs_f64(),
            uploaded.accepting.as_secs_f64(),
        ));
    }
    for warning in &uploaded.warnings {
        eprintln!("warning: {warning}");
    }
    output::print(output, &[LogRow::from_log(&uploaded.drive_log)])
}

/// Reads one log, `driveLogs/{id}`.
pub(crate) async fn read(connection: &Connection, name: &str) -> anyhow::Result<v1::DriveLog> {
    let request = v1::GetDriveLogRequest {
        name: name.to_owned(),
    };
    let reply = connection.drive_logs().get_drive_log(request).await;
    let reply = reply
        .map_err(|status| backlot_client::Error::from_status(&format!("reading {name}"), status))?;
    let log = reply.into_inner().drive_log;
    log.context("the reply holds no log")
}

async fn show(connection: &Connection, log: &str, output: Output) -> anyhow::Result<()> {
    let log = read(connection, &names::drive_log(log)?).await?;
    output::print(output, &[LogRow::from_log(&log)])?;
    if output == Output::Table {
        println!();
        let tracks: Vec<_> = log.tracks.iter().map(TrackRow::new).collect();
        output::print(output, &tracks)?;
        for note in &log.notes {
            println!("note: {note}");
        }
    }
    Ok(())
}

#[derive(Serialize)]
struct LogRow {
    name: String,
    dataset: String,
    synthetic: bool,
    cameras: u32,
    frames: u32,
    sweeps: u32,
    tracks: u32,
    travel_m: f64,
    created: Option<String>,
}

impl LogRow {
    fn from_summary(summary: v1::DriveLogSummary) -> Self {
        Self {
            name: summary.name,
            dataset: summary.dataset,
            synthetic: summary.synthetic,
            cameras: summary.camera_count,
            frames: summary.frame_count,
            sweeps: summary.sweep_count,
            tracks: summary.track_count,
            travel_m: summary.travel_m,
            created: summary.create_time.map(|t| t.to_string()),
        }
    }

    fn from_log(log: &v1::DriveLog) -> Self {
        let position = |p: &v1::TimedPose| rigid_from_wire(p.pose.as_ref()).translation_m;
        let steps = log.world_from_ego.windows(2);
        Self {
            name: log.name.clone(),
            dataset: log.dataset.clone(),
            synthetic: log.synthetic,
            cameras: log.cameras.len() as u32,
            frames: log.frames.len() as u32,
            sweeps: log.sweeps.len() as u32,
            tracks: log.tracks.len() as u32,
            travel_m: steps
                .map(|pair| position(&pair[0]).distance(position(&pair[1])))
                .sum(),
            created: log.create_time.map(|t| t.to_string()),
        }
    }
}

impl Row for LogRow {
    const COLUMNS: &'static [&'static str] = &[
        "NAME",
        "DATASET",
        "SYNTHETIC",
        "CAMERAS",
        "FRAMES",
        "SWEEPS",
        "TRACKS",
        "TRAVEL",
        "CREATED",
    ];

    fn cells(&self) -> Vec<String> {
        vec![
            names::id(&self.name).to_owned(),
            self.dataset.clone(),
            if self.synthetic { "yes" } else { "no" }.to_owned(),
            self.cameras.to_string(),
            self.frames.to_string(),
            self.sweeps.to_string(),
            self.tracks.to_string(),
            format!("{:.1} m", self.travel_m),
            self.created.clone().unwrap_or_default(),
        ]
    }
}

#[derive(Serialize)]
struct TrackRow {
    track: String,
    class: String,
    size_m: [f64; 3],
    states: usize,
}

impl TrackRow {
    fn new(track: &v1::Track) -> Self {
        Self {
            track: track.track_id.clone(),
            class: track.source_class.clone(),
            size_m: vector_from_wire(track.size_m.as_ref()).to_array(),
            states: track.states.len(),
        }
    }
}

impl Row for TrackRow {
    const COLUMNS: &'static [&'static str] = &["TRACK", "CLASS", "LENGTH WIDTH HEIGHT", "STATES"];

    fn cells(&self) -> Vec<String> {
        let [l, w, h] = self.size_m;
        vec![
            self.track.clone(),
            self.class.clone(),
            format!("{l:.2} {w:.2} {h:.2} m"),
            self.states.to_string(),
        ]
    }
}
