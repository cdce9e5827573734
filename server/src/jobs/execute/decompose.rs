//! Segments and decomposes a log and keeps the result for later jobs; trains nothing.

use super::budget::{LEAST_FRAMES, Plan};
use super::control::report;
use super::error::Error;
use super::labels::{MaskedLog, inputs, masked, stored};
use super::objects::{count, too_few};
use super::{Masking, PortBlobs};
use crate::domain::drive_log::DriveLog;
use crate::domain::job::{JobReport, TrackDecision};
use crate::ingest::{
    Decomposition, LabelledTrack, ObjectPixels, Rejections, Segmentation, Subject, TrackPlan,
    decompose, plan_objects,
};
use crate::jobs::worker_port::{Completion, JobControl, LeasedJob, NewDecomposition, WorkerPort};

/// Share of the progress bar after which only the manifest is left to write.
const DECOMPOSED: f64 = 0.98;

pub(super) fn run(
    job: &LeasedJob,
    log: &DriveLog,
    port: &dyn WorkerPort,
    control: &JobControl,
    masking: &Masking,
) -> Result<Completion, Error> {
    let inputs = inputs(job, log, masking);
    let plans = plan_objects(log);
    let budget = Plan::new(job.spec.budget);
    if let Some((known, stored)) = stored(&inputs, port)? {
        let note = format!(
            "nothing changed since {}, whose decomposition stands",
            known.job
        );
        return Ok(Completion {
            report: job_report(log, &plans, &stored, &budget, vec![note]),
            ..Default::default()
        });
    }
    let MaskedLog {
        log,
        segmentation,
        masks,
    } = &masked(log.clone(), port, control, masking)?;
    let (promising, _): (Vec<_>, Vec<_>) = plans
        .iter()
        .cloned()
        .partition(|plan| plan.frames.len() >= LEAST_FRAMES);
    let subject = Subject {
        log,
        segmentation: segmentation.as_ref(),
        masks,
        plans: &promising,
        inputs: inputs.digest(),
    };
    let progress = |done: usize, count: usize| {
        let fraction = DECOMPOSED * done as f64 / count.max(1) as f64;
        report(
            control,
            fraction,
            "decompose",
            done,
            count,
            "labelling frames",
        );
        !control.cancelled()
    };
    let write = |content: &[u8]| port.write_blob(content);
    let made = decompose(&subject, &PortBlobs(port), write, progress)?.ok_or(Error::Cancelled)?;
    let notes = segmentation.iter().map(Segmentation::summary).collect();
    report(control, DECOMPOSED, "publish", 0, 1, "writing the manifest");
    let manifest = port.write_blob(&made.to_json())?;
    Ok(Completion {
        assets: Vec::new(),
        report: job_report(log, &plans, &made, &budget, notes),
        decomposition: Some(NewDecomposition {
            inputs: made.inputs,
            manifest,
        }),
    })
}

fn job_report(
    log: &DriveLog,
    plans: &[TrackPlan],
    made: &Decomposition,
    budget: &Plan,
    mut warnings: Vec<String>,
) -> JobReport {
    let tracks: Vec<TrackDecision> = plans
        .iter()
        .map(|plan| {
            let track_id = &log.tracks[plan.track].track_id;
            let labelled = made.objects.iter().find(|t| t.track_id == *track_id);
            decision(track_id, plan, labelled, budget)
        })
        .collect();
    if !tracks.iter().any(|track| track.kept) {
        warnings.push("no usable object found".to_owned());
    }
    JobReport {
        warnings,
        tracks,
        free_masks: made.free_masks.clone(),
    }
}

/// What the budget's training would do with a track.
fn decision(
    track_id: &str,
    plan: &TrackPlan,
    labelled: Option<&LabelledTrack>,
    budget: &Plan,
) -> TrackDecision {
    let mut decision = TrackDecision {
        track_id: track_id.to_owned(),
        usable_frames: plan.frames.len() as u32,
        moving: plan.moving,
        ..Default::default()
    };
    count(&mut decision, &plan.rejected);
    // With fewer frames than the budget needs, what masks and returns say of them changes nothing and is not counted.
    if let Some(labelled) = labelled.filter(|_| plan.frames.len() >= budget.least_frames) {
        let mut rejected = Rejections::new();
        for frame in &labelled.frames {
            if let ObjectPixels::Rejected(reason) = &frame.found {
                *rejected.entry(*reason).or_default() += 1;
            }
        }
        let lost: u32 = rejected.values().sum();
        decision.usable_frames = labelled.frames.len() as u32 - lost;
        count(&mut decision, &rejected);
    }
    decision.reason = too_few(decision.usable_frames, budget.least_frames);
    decision.kept = decision.reason.is_empty();
    decision
}
