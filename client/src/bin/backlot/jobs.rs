//! `backlot jobs`.

use std::collections::BTreeMap;
use std::time::{SystemTime, UNIX_EPOCH};

use anyhow::{Context, bail};
use backlot_client::watch::{create_job, watch_job};
use backlot_client::{Connection, listing, names};
use backlot_proto::v1;
use serde::Serialize;

use crate::args::{Budget, JobKind, JobsCommand, Output, SubmitOptions};
use crate::output::{self, Row};
use crate::progress::Progress;
use crate::tracks;

pub(crate) async fn run(
    connection: &Connection,
    command: JobsCommand,
    output: Output,
) -> anyhow::Result<()> {
    match command {
        JobsCommand::Submit(options) => submit(connection, options, output).await,
        JobsCommand::List { log } => {
            let log = log.map(|log| names::drive_log(&log)).transpose()?;
            let jobs = listing::jobs(connection, &log.unwrap_or_default()).await?;
            output::print(output, &jobs.iter().map(JobRow::new).collect::<Vec<_>>())
        }
        JobsCommand::Watch { job } => watch(connection, &names::job(&job)?, output).await,
        JobsCommand::Cancel { job } => {
            let name = names::job(&job)?;
            let request = v1::CancelJobRequest { name: name.clone() };
            let reply = connection.jobs().cancel_job(request).await;
            let reply = reply.map_err(|status| {
                backlot_client::Error::from_status(&format!("cancelling {name}"), status)
            })?;
            let job = reply.into_inner().job.context("the reply holds no job")?;
            output::print(output, &[JobRow::new(&job)])
        }
    }
}

async fn submit(
    connection: &Connection,
    options: SubmitOptions,
    output: Output,
) -> anyhow::Result<()> {
    let request = v1::CreateJobRequest {
        kind: wire_kind(options.kind).into(),
        drive_log: names::drive_log(&options.log)?,
        budget: wire_budget(options.budget).into(),
        seed: options.seed,
        request_id: options.request_id.unwrap_or_else(fresh_request_id),
        hold_out_every: options.hold_out_every.unwrap_or(0),
    };
    let job = create_job(connection, request).await?;
    if options.watch {
        watch(connection, &job.name, output).await
    } else {
        output::print(output, &[JobRow::new(&job)])
    }
}

async fn watch(connection: &Connection, name: &str, output: Output) -> anyhow::Result<()> {
    let job = follow(connection, name, names::id(name)).await?;
    output::print(output, &[JobRow::new(&job)])
}

/// Follows a job with a progress bar, prints its warnings and fails if it did not succeed.
pub(crate) async fn follow(
    connection: &Connection,
    name: &str,
    label: &str,
) -> anyhow::Result<v1::Job> {
    let progress = Progress::job(label);
    let job = watch_job(connection, name, |job| progress.set_job(job)).await?;
    progress.finish(
        &job.state()
            .as_str_name()
            .replace("JOB_STATE_", "")
            .to_lowercase(),
    );
    for warning in &job.warnings {
        eprintln!("warning: {warning}");
    }
    for track in job.tracks.iter().filter(|track| !track.kept) {
        eprintln!("note: {}", rejection(track));
    }
    if !job.free_masks.is_empty() {
        let counts = tracks::counts(&job.free_masks);
        eprintln!("note: masks that name no track: {counts}");
    }
    match job.state() {
        v1::JobState::Succeeded => {}
        v1::JobState::Failed => {
            let error = job.error.unwrap_or_default();
            bail!("{name} failed: {} [{}]", error.message, error.reason)
        }
        _ => bail!("{name} was cancelled"),
    }
    let found_nothing = job.kind() == v1::JobKind::Objects && job.assets.is_empty();
    if found_nothing && job.warnings.is_empty() {
        eprintln!("warning: no usable object found");
    }
    Ok(job)
}

/// Why a track became no asset.
fn rejection(track: &v1::TrackDecision) -> String {
    let counts = tracks::counts(&track.rejected_by_reason);
    format!(
        "track {} became no object: {} ({} frames usable; {})",
        track.track_id,
        track.reason,
        track.usable_frames,
        if counts.is_empty() {
            "none rejected"
        } else {
            &counts
        },
    )
}

pub(crate) fn wire_budget(budget: Budget) -> v1::Budget {
    match budget {
        Budget::Quick => v1::Budget::Quick,
        Budget::Standard => v1::Budget::Standard,
        Budget::Paper => v1::Budget::Paper,
    }
}

fn wire_kind(kind: JobKind) -> v1::JobKind {
    match kind {
        JobKind::Background => v1::JobKind::Background,
        JobKind::Objects => v1::JobKind::Objects,
        JobKind::Decompose => v1::JobKind::Decompose,
    }
}

/// Unique enough to tell submissions apart: the process and the time to the nanosecond.
fn fresh_request_id() -> String {
    let since = SystemTime::now().duration_since(UNIX_EPOCH);
    let nanoseconds = since.map_or(0, |elapsed| elapsed.as_nanos());
    format!("cli-{}-{nanoseconds}", std::process::id())
}

#[derive(Serialize)]
struct JobRow {
    name: String,
    kind: String,
    drive_log: String,
    state: String,
    fraction: f64,
    stage: String,
    attempt: u32,
    error: Option<String>,
    assets: Vec<String>,
    warnings: Vec<String>,
    tracks: Vec<TrackFields>,
    free_masks: BTreeMap<String, u32>,
    created: Option<String>,
}

/// What became of one track.
#[derive(Serialize)]
struct TrackFields {
    track: String,
    kept: bool,
    moving: bool,
    usable_frames: u32,
    reason: String,
}

impl JobRow {
    fn new(job: &v1::Job) -> Self {
        let progress = job.progress.clone().unwrap_or_default();
        let error = job.error.as_ref();
        Self {
            name: job.name.clone(),
            kind: job.kind().as_str_name().replace("JOB_KIND_", ""),
            drive_log: job.drive_log.clone(),
            state: job.state().as_str_name().replace("JOB_STATE_", ""),
            fraction: progress.fraction,
            stage: progress.stage,
            attempt: job.attempt,
            error: error.map(|e| format!("{}: {}", e.reason, e.message)),
            assets: job.assets.clone(),
            warnings: job.warnings.clone(),
            tracks: job.tracks.iter().map(TrackFields::new).collect(),
            free_masks: job.free_masks.clone().into_iter().collect(),
            created: job.create_time.map(|t| t.to_string()),
        }
    }
}

impl TrackFields {
    fn new(track: &v1::TrackDecision) -> Self {
        Self {
            track: track.track_id.clone(),
            kept: track.kept,
            moving: track.moving,
            usable_frames: track.usable_frames,
            reason: track.reason.clone(),
        }
    }
}

impl Row for JobRow {
    const COLUMNS: &'static [&'static str] = &[
        "NAME", "KIND", "LOG", "STATE", "DONE", "STAGE", "ASSETS", "CREATED", "ERROR",
    ];

    fn cells(&self) -> Vec<String> {
        vec![
            names::id(&self.name).to_owned(),
            self.kind.clone(),
            names::id(&self.drive_log).to_owned(),
            self.state.clone(),
            format!("{:.0} %", 100.0 * self.fraction),
            output::or_dash(&self.stage),
            self.assets.len().to_string(),
            self.created.clone().unwrap_or_default(),
            self.error.clone().unwrap_or_else(|| "-".to_owned()),
        ]
    }
}
