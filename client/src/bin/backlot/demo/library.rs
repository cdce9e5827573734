//! Training what the samples are made of.

use std::collections::BTreeSet;

use anyhow::Context;
use backlot_client::generator::StreetConfig;
use backlot_client::upload::upload_log;
use backlot_client::watch::create_job;
use backlot_client::{Connection, listing};
use backlot_proto::v1;

use super::source::Source;
use crate::jobs::follow;
use crate::progress::Progress;

/// With fewer objects than this from the log itself, generated ones are added: none of two or three may fit a mover's slot.
const ENOUGH_OBJECTS: usize = 4;

/// The assets of one run.
pub(crate) struct Library {
    pub background: v1::Asset,
    /// Trained from the log, in the order of the tracks.
    pub objects: Vec<v1::Asset>,
    /// Trained from a generated log because the log itself gave too few.
    pub supplied: Vec<v1::Asset>,
    /// Tracks that move.
    pub moving: BTreeSet<String>,
}

impl Library {
    /// Assets that recipes may place.
    pub(crate) fn placeable(&self) -> Vec<&v1::Asset> {
        let all = self.objects.iter().chain(&self.supplied);
        all.filter(|asset| asset.usage() == v1::AssetUsage::Library)
            .collect()
    }
}

pub(crate) async fn upload(connection: &Connection, source: &Source) -> anyhow::Result<()> {
    let progress = std::sync::Mutex::new(Progress::bytes("upload"));
    let uploaded = upload_log(connection, &source.log, &source.name, &|bytes| {
        if let Ok(progress) = progress.lock() {
            progress.set_bytes(bytes);
        }
    })
    .await?;
    if let Ok(progress) = progress.into_inner() {
        progress.finish(&format!("{} blobs sent", uploaded.blobs_sent));
    }
    for warning in &uploaded.warnings {
        eprintln!("warning: {warning}");
    }
    Ok(())
}

/// Queues a job, follows it, and returns it with its assets.
pub(crate) async fn train(
    connection: &Connection,
    drive_log: &str,
    kind: v1::JobKind,
    budget: v1::Budget,
    seed: u64,
) -> anyhow::Result<(v1::Job, Vec<v1::Asset>)> {
    let request = v1::CreateJobRequest {
        kind: kind.into(),
        drive_log: drive_log.to_owned(),
        budget: budget.into(),
        seed,
        ..Default::default()
    };
    let job = create_job(connection, request).await?;
    let label = match kind {
        v1::JobKind::Background => "background",
        _ => "objects",
    };
    let job = follow(connection, &job.name, label).await?;
    let all = listing::assets(connection, v1::AssetKind::Unspecified, drive_log).await?;
    let mut assets: Vec<v1::Asset> = all
        .into_iter()
        .filter(|asset| job.assets.contains(&asset.name))
        .collect();
    assets.sort_by(|a, b| a.source_track_id.cmp(&b.source_track_id));
    Ok((job, assets))
}

pub(crate) fn only_background(assets: Vec<v1::Asset>) -> anyhow::Result<v1::Asset> {
    let background = assets.into_iter().next();
    background.context("the job published no background")
}

/// Tracks that decomposition found moving.
pub(crate) fn moving_tracks(job: &v1::Job) -> BTreeSet<String> {
    let moving = job.tracks.iter().filter(|track| track.moving);
    moving.map(|track| track.track_id.clone()).collect()
}

/// Objects of a small generated street, for a recorded log that gave too few of its own.
pub(crate) async fn supply(
    connection: &Connection,
    objects: &[v1::Asset],
    seed: u64,
) -> anyhow::Result<Vec<v1::Asset>> {
    let own = objects
        .iter()
        .filter(|a| a.usage() == v1::AssetUsage::Library);
    let own = own.count();
    if own >= ENOUGH_OBJECTS {
        return Ok(Vec::new());
    }
    eprintln!(
        "note: the log gave {own} objects that may be placed freely; objects of a generated (synthetic) street are added"
    );
    let config = StreetConfig {
        seed,
        parked_cars: 6,
        moving_cars: 0,
        ..StreetConfig::default()
    };
    let name = format!("driveLogs/supply-{seed}");
    let street = tokio::task::block_in_place(|| Source::generate(&config, &name))?;
    upload(connection, &street).await?;
    let (_, assets) = train(
        connection,
        &name,
        v1::JobKind::Objects,
        v1::Budget::Quick,
        seed,
    )
    .await?;
    Ok(assets)
}
