//! `backlot logs show LOG --tracks`: what the newest decomposition made of a log's tracks.

use std::collections::HashMap;

use anyhow::bail;
use backlot_client::{Connection, listing, names};
use backlot_proto::v1;
use serde::Serialize;

use crate::args::Output;
use crate::logs;
use crate::output::{self, Row};

/// Prints one row a track, those that show most of the object first. `log` is `driveLogs/{id}`.
pub(crate) async fn show(connection: &Connection, log: &str, output: Output) -> anyhow::Result<()> {
    let known = logs::read(connection, log).await?;
    let jobs = listing::jobs(connection, log).await?;
    let Some(job) = newest_decomposition(&jobs) else {
        let id = names::id(log);
        bail!(
            "{log} has not been decomposed; run `backlot jobs submit decompose --log {id} --watch` first"
        )
    };
    let class_of: HashMap<&str, &str> = known
        .tracks
        .iter()
        .map(|track| (track.track_id.as_str(), track.source_class.as_str()))
        .collect();
    let rows: Vec<_> = job
        .tracks
        .iter()
        .map(|track| DecisionRow::new(track, class_of.get(track.track_id.as_str()).copied()))
        .collect();
    output::print(output, &rows)?;
    if output == Output::Table {
        println!();
        println!("by {}", job.name);
        if !job.free_masks.is_empty() {
            println!("masks that name no track: {}", counts(&job.free_masks));
        }
    }
    Ok(())
}

fn newest_decomposition(jobs: &[v1::Job]) -> Option<&v1::Job> {
    let is_done = |job: &&v1::Job| {
        job.kind() == v1::JobKind::Decompose && job.state() == v1::JobState::Succeeded
    };
    let ended = |job: &&v1::Job| job.end_time.map(|t| (t.seconds, t.nanos));
    jobs.iter().filter(is_done).max_by_key(ended)
}

/// "12 truncated, 3 occluded"; empty if nothing was counted.
pub(crate) fn counts(by_reason: &HashMap<String, u32>) -> String {
    let mut sorted: Vec<_> = by_reason.iter().collect();
    sorted.sort();
    let counts: Vec<String> = sorted
        .into_iter()
        .map(|(reason, count)| format!("{count} {reason}"))
        .collect();
    counts.join(", ")
}

#[derive(Serialize)]
struct DecisionRow {
    track: String,
    class: String,
    moving: bool,
    kept: bool,
    usable_frames: u32,
    rejected_frames: u32,
    rejected_by_reason: HashMap<String, u32>,
    reason: String,
}

impl DecisionRow {
    fn new(track: &v1::TrackDecision, class: Option<&str>) -> Self {
        Self {
            track: track.track_id.clone(),
            class: class.unwrap_or_default().to_owned(),
            moving: track.moving,
            kept: track.kept,
            usable_frames: track.usable_frames,
            rejected_frames: track.rejected_frames,
            rejected_by_reason: track.rejected_by_reason.clone(),
            reason: track.reason.clone(),
        }
    }
}

impl Row for DecisionRow {
    const COLUMNS: &'static [&'static str] = &[
        "TRACK",
        "CLASS",
        "MOVES",
        "KEPT",
        "FRAMES",
        "REJECTED",
        "BY REASON",
        "WHY NOT",
    ];

    fn cells(&self) -> Vec<String> {
        let yes = |is: bool| if is { "yes" } else { "no" }.to_owned();
        vec![
            self.track.clone(),
            output::or_dash(&self.class),
            yes(self.moving),
            yes(self.kept),
            self.usable_frames.to_string(),
            self.rejected_frames.to_string(),
            output::or_dash(&counts(&self.rejected_by_reason)),
            output::or_dash(&self.reason),
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn job(kind: v1::JobKind, state: v1::JobState, ended_s: i64) -> v1::Job {
        let mut job = v1::Job {
            kind: kind.into(),
            state: state.into(),
            ..Default::default()
        };
        job.end_time.get_or_insert_default().seconds = ended_s;
        job
    }

    #[test]
    fn the_newest_finished_decomposition_is_shown() {
        use v1::{JobKind, JobState};
        let jobs = [
            job(JobKind::Decompose, JobState::Succeeded, 10),
            job(JobKind::Decompose, JobState::Succeeded, 30),
            job(JobKind::Decompose, JobState::Failed, 40),
            job(JobKind::Objects, JobState::Succeeded, 50),
            job(JobKind::Decompose, JobState::Succeeded, 20),
        ];
        let found = newest_decomposition(&jobs).expect("there are three");
        assert_eq!(found.end_time.map(|t| t.seconds), Some(30));
        assert!(newest_decomposition(&jobs[2..4]).is_none());
    }

    #[test]
    fn counts_are_sorted_by_reason() {
        let by_reason = [("truncated".to_owned(), 3), ("occluded".to_owned(), 12)];
        assert_eq!(counts(&by_reason.into()), "12 occluded, 3 truncated");
        assert_eq!(counts(&HashMap::new()), "");
    }
}
