//! Jobs on the wire.

use backlot_proto::v1;
use tonic::Status;

use super::status::invalid_field;
use super::time::timestamp;
use crate::domain::job::{
    Budget, Job, JobKind, JobReport, JobSpec, JobState, Progress, TrackDecision,
};

/// Every n-th frame is held out where the request does not say.
const HOLD_OUT_EVERY: u32 = 8;

pub(crate) fn spec_from_wire(request: &v1::CreateJobRequest) -> Result<JobSpec, Status> {
    Ok(JobSpec {
        kind: match v1::JobKind::try_from(request.kind) {
            Ok(v1::JobKind::Background) => JobKind::Background,
            Ok(v1::JobKind::Objects) => JobKind::Objects,
            Ok(v1::JobKind::Decompose) => JobKind::Decompose,
            Ok(v1::JobKind::Unspecified) | Err(_) => {
                let why = "is none of BACKGROUND, OBJECTS and DECOMPOSE";
                return Err(invalid_field("kind", why));
            }
        },
        drive_log: request
            .drive_log
            .parse()
            .map_err(|e| invalid_field("drive_log", e))?,
        budget: match v1::Budget::try_from(request.budget) {
            Ok(v1::Budget::Unspecified | v1::Budget::Standard) => Budget::Standard,
            Ok(v1::Budget::Quick) => Budget::Quick,
            Ok(v1::Budget::Paper) => Budget::Paper,
            Err(_) => return Err(invalid_field("budget", "is not a budget")),
        },
        seed: request.seed,
        hold_out_every: match request.hold_out_every {
            0 => HOLD_OUT_EVERY,
            1 => {
                let why = "is 1, which holds every frame out; use 0 for the default or at least 2";
                return Err(invalid_field("hold_out_every", why));
            }
            every => every,
        },
    })
}

pub(crate) fn job_to_wire(job: &Job, report: JobReport) -> v1::Job {
    let kind = match job.spec.kind {
        JobKind::Background => v1::JobKind::Background,
        JobKind::Objects => v1::JobKind::Objects,
        JobKind::Decompose => v1::JobKind::Decompose,
    };
    let budget = match job.spec.budget {
        Budget::Quick => v1::Budget::Quick,
        Budget::Standard => v1::Budget::Standard,
        Budget::Paper => v1::Budget::Paper,
    };
    let (state, error) = match &job.state {
        JobState::Queued { .. } => (v1::JobState::Queued, None),
        JobState::Running { .. } => (v1::JobState::Running, None),
        JobState::Succeeded => (v1::JobState::Succeeded, None),
        JobState::Failed { failure } => (
            v1::JobState::Failed,
            Some(v1::JobError {
                reason: failure.reason.clone(),
                message: failure.message.clone(),
            }),
        ),
        JobState::Cancelled => (v1::JobState::Cancelled, None),
    };
    v1::Job {
        name: job.id.to_string(),
        kind: kind.into(),
        drive_log: job.spec.drive_log.to_string(),
        budget: budget.into(),
        seed: job.spec.seed,
        state: state.into(),
        progress: Some(progress_to_wire(&job.progress)),
        attempt: job.attempt,
        error,
        assets: job.assets.iter().map(ToString::to_string).collect(),
        warnings: report.warnings,
        tracks: report.tracks.into_iter().map(track_to_wire).collect(),
        hold_out_every: job.spec.hold_out_every,
        free_masks: report.free_masks.into_iter().collect(),
        create_time: Some(timestamp(job.created_at)),
        start_time: job.started_at.map(timestamp),
        end_time: job.ended_at.map(timestamp),
    }
}

fn progress_to_wire(progress: &Progress) -> v1::JobProgress {
    v1::JobProgress {
        fraction: progress.fraction,
        stage: progress.stage.clone(),
        step: progress.step,
        step_count: progress.step_count,
        message: progress.message.clone(),
    }
}

fn track_to_wire(track: TrackDecision) -> v1::TrackDecision {
    v1::TrackDecision {
        track_id: track.track_id,
        kept: track.kept,
        usable_frames: track.usable_frames,
        rejected_frames: track.rejected_frames,
        rejected_by_reason: track.rejected_by_reason.into_iter().collect(),
        reason: track.reason,
        moving: track.moving,
    }
}
