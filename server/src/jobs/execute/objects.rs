//! Trains the usable objects of a log, those with most pixels first.

use backlot_engine::asset::{AssetHeader, AssetKind, Usage};
use backlot_engine::backend::cpu::CpuBackend;
use backlot_engine::quality::ViewCoverage;
use backlot_engine::train::{Trained, train_object};
use backlot_engine::{Error as EngineError, camera::Rigid};

use super::PortBlobs;
use super::background::{header, publish};
use super::budget::Plan;
use super::control::{RunControl, report};
use super::error::Error;
use super::gate::replay_only_reason;
use super::labels::JobLabels;
use super::quality::quality_record;
use crate::domain::asset::{NewAsset, ObjectSubject, Usage as RecordUsage};
use crate::domain::drive_log::{DriveLog, Track};
use crate::domain::job::{JobReport, TrackDecision};
use crate::ingest::{ObjectSet, Rejections, TrackPlan, object_set, plan_objects};
use crate::jobs::worker_port::{Completion, JobControl, LeasedJob, WorkerPort};

pub(super) fn run(
    job: &LeasedJob,
    log: &DriveLog,
    labels: &JobLabels,
    port: &dyn WorkerPort,
    control: &JobControl,
) -> Result<Completion, Error> {
    let budget = Plan::new(job.spec.budget);
    let mut work = ObjectsJob {
        job,
        log,
        labels,
        port,
        control,
        budget: &budget,
        assets: Vec::new(),
        report: JobReport {
            free_masks: labels.free_masks.clone(),
            warnings: labels.note.iter().cloned().collect(),
            tracks: Vec::new(),
        },
    };
    let plans = plan_objects(log);
    let promising = |p: &&TrackPlan| p.frames.len() >= budget.least_frames;
    let expected = plans.iter().filter(promising).count();
    for plan in &plans {
        work.take(plan, expected.min(budget.most_objects))?;
    }
    if work.assets.is_empty() {
        work.report
            .warnings
            .push("no usable object found".to_owned());
    }
    Ok(Completion {
        assets: work.assets,
        report: work.report,
        decomposition: None,
    })
}

struct ObjectsJob<'a> {
    job: &'a LeasedJob,
    log: &'a DriveLog,
    labels: &'a JobLabels,
    port: &'a dyn WorkerPort,
    control: &'a JobControl,
    budget: &'a Plan,
    assets: Vec<NewAsset>,
    report: JobReport,
}

impl ObjectsJob<'_> {
    /// Decides on one track and trains it if it is usable.
    fn take(&mut self, plan: &TrackPlan, expected: usize) -> Result<(), Error> {
        let track = &self.log.tracks[plan.track];
        let mut decision = TrackDecision {
            track_id: track.track_id.clone(),
            usable_frames: plan.frames.len() as u32,
            moving: plan.moving,
            ..Default::default()
        };
        count(&mut decision, &plan.rejected);
        let least = self.budget.least_frames;
        if plan.frames.len() < least {
            decision.reason = too_few(decision.usable_frames, least);
        } else if self.assets.len() == self.budget.most_objects {
            let most = self.budget.most_objects;
            decision.reason = format!("the budget's {most} objects were larger");
        } else {
            self.build(plan, expected, &mut decision)?;
        }
        decision.kept = decision.reason.is_empty();
        self.report.tracks.push(decision);
        Ok(())
    }

    fn build(
        &mut self,
        plan: &TrackPlan,
        expected: usize,
        decision: &mut TrackDecision,
    ) -> Result<(), Error> {
        let share = 1.0 / expected.max(1) as f64;
        let start = (share * self.assets.len() as f64).min(1.0 - share);
        let set = self.decode(plan, start)?;
        count(decision, &set.rejected);
        decision.usable_frames = set.usable_frames;
        let least = self.budget.least_frames;
        decision.reason = too_few(set.usable_frames, least);
        if !decision.reason.is_empty() {
            return Ok(());
        }
        let track = &self.log.tracks[plan.track];
        let what = format!("{} {}", track.class.name(), track.track_id);
        let run = RunControl::new(self.control, start, share, what);
        match train_object(
            &set.input,
            &self.budget.object,
            self.job.spec.seed,
            &CpuBackend,
            &run,
        ) {
            Ok(trained) => {
                let asset = self.publish(plan, &set, trained)?;
                self.assets.push(asset);
            }
            // One object that cannot be trained does not take the others with it.
            Err(error @ (EngineError::Invalid { .. } | EngineError::Diverged { .. })) => {
                let warning = format!("track {}: {error}", track.track_id);
                self.report.warnings.push(warning);
                decision.reason = error.to_string();
            }
            Err(error) => return Err(error.into()),
        }
        Ok(())
    }

    fn decode(&self, plan: &TrackPlan, start: f64) -> Result<ObjectSet, Error> {
        let id = &self.log.tracks[plan.track].track_id;
        let message = format!("decoding frames of track {id}");
        let message = self.labels.while_decoding(&message);
        let progress = |done: usize, count: usize| {
            report(self.control, start, "decode", done, count, &message);
            !self.control.cancelled()
        };
        let every = self.job.spec.hold_out_every as usize;
        let blobs = PortBlobs(self.port);
        object_set(self.log, &blobs, &self.labels.labels, plan, every, progress)?
            .ok_or(Error::Cancelled)
    }

    fn publish(
        &self,
        plan: &TrackPlan,
        set: &ObjectSet,
        trained: Trained,
    ) -> Result<NewAsset, Error> {
        let track = &self.log.tracks[plan.track];
        let symmetric = set.input.symmetric;
        let coverage = ViewCoverage::of_cameras(&set.object_from_camera, symmetric);
        let reason = replay_only_reason(&trained.quality, &coverage);
        let quality = quality_record(&trained.quality, Some(&coverage));
        let header = AssetHeader {
            kind: AssetKind::Object,
            class: track.class,
            size_m: track.size_m,
            symmetric,
            usage: match reason {
                None => Usage::Library,
                Some(_) => Usage::ReplayOnly,
            },
            usage_reason: reason.clone().unwrap_or_default(),
            source_track_id: track.track_id.clone(),
            quality: trained.quality,
            coverage: Some(coverage),
            ego_from_object: ego_from_object(self.log, track, &plan.frames),
            ..header(self.log)
        };
        let payload = publish(self.port, self.control, header, trained.field)?;
        Ok(NewAsset {
            object: Some(ObjectSubject {
                class: track.class,
                size_m: track.size_m.to_array(),
                track_id: track.track_id.clone(),
            }),
            usage: match reason {
                None => RecordUsage::Library,
                Some(reason) => RecordUsage::ReplayOnly { reason },
            },
            payload,
            quality,
            synthetic: self.log.synthetic,
        })
    }
}

/// Why a track with so few frames is not kept; empty if they are enough.
pub(super) fn too_few(usable_frames: u32, least: usize) -> String {
    if (usable_frames as usize) < least {
        format!("{usable_frames} usable frames, {least} needed")
    } else {
        String::new()
    }
}

pub(super) fn count(decision: &mut TrackDecision, rejected: &Rejections) {
    for (reason, frames) in rejected {
        decision.rejected_frames += frames;
        *decision
            .rejected_by_reason
            .entry(reason.name().to_owned())
            .or_default() += frames;
    }
}

/// Where the object stood relative to the ego in each usable frame.
fn ego_from_object(log: &DriveLog, track: &Track, frames: &[usize]) -> Vec<Rigid> {
    frames
        .iter()
        .filter_map(|&i| {
            let timestamp_ns = log.frames[i].timestamp_ns;
            let world_from_ego = log.world_from_ego.at(timestamp_ns)?;
            Some(world_from_ego.inverse() * track.at(timestamp_ns)?)
        })
        .collect()
}
