//! Trains one background.

use backlot_engine::asset::{AssetHeader, AssetKind, ColorSpace, FORMAT_VERSION, Usage};
use backlot_engine::backend::cpu::CpuBackend;
use backlot_engine::camera::Rigid;
use backlot_engine::class::ObjectClass;
use backlot_engine::scene::{ValidRegion, measure_daylight};
use backlot_engine::train::train_background;
use backlot_engine::{Asset, Field};
use glam::DVec3;

use super::PortBlobs;
use super::budget::Plan;
use super::control::{RunControl, report};
use super::error::Error;
use super::labels::JobLabels;
use super::quality::quality_record;
use crate::domain::asset::{NewAsset, QualityReport, Usage as RecordUsage};
use crate::domain::drive_log::DriveLog;
use crate::domain::job::JobReport;
use crate::ingest::{BackgroundSet, background_set, recording};
use crate::jobs::worker_port::{Completion, JobControl, LeasedJob, WorkerPort};

/// Shares of the progress bar.
const DECODED: f64 = 0.06;
const TRAINED: f64 = 0.95;

pub(super) fn run(
    job: &LeasedJob,
    log: &DriveLog,
    labels: &JobLabels,
    port: &dyn WorkerPort,
    control: &JobControl,
) -> Result<Completion, Error> {
    let plan = Plan::new(job.spec.budget);
    let BackgroundSet {
        input,
        image_size,
        depth_warning,
    } = decode(job, log, labels, port, control, &plan)?;
    let mut warnings: Vec<String> = depth_warning.into_iter().collect();
    let (width, height) = image_size;
    let what = format!("background of {} at {width}x{height}", log.id);
    let run = RunControl::new(control, DECODED, TRAINED - DECODED, what);
    let trained = train_background(&input, &plan.background, job.spec.seed, &CpuBackend, &run)?;
    drop(input);
    report(
        control,
        TRAINED,
        "evaluate",
        0,
        1,
        "finding the valid region",
    );
    let mut recording = recording(log, &labels.tied_masks);
    let region = ValidRegion::build(&trained.field, &recording, &plan.region);
    recording.daylight = measure_daylight(&trained.field, &recording, &region);
    if region.free_cells().next().is_none() {
        warnings.push("no free ground was found: nothing can be inserted".to_owned());
    }
    let mut quality = trained.quality;
    quality.warnings.extend(warnings.iter().cloned());
    let record = QualityReport {
        image_size_px: Some(image_size),
        ..quality_record(&quality, None)
    };
    // For the job's report alone: it says nothing of the asset's quality.
    warnings.extend(labels.note.clone());
    let header = AssetHeader {
        kind: AssetKind::Background,
        local_from_world: log.local_from_world,
        quality,
        recording: Some(recording),
        valid_region: Some(region),
        ..header(log)
    };
    let payload = publish(port, control, header, trained.field)?;
    Ok(Completion {
        assets: vec![NewAsset {
            object: None,
            usage: RecordUsage::Library,
            payload,
            quality: record,
            synthetic: log.synthetic,
        }],
        report: JobReport {
            warnings,
            tracks: Vec::new(),
            free_masks: labels.free_masks.clone(),
        },
        decomposition: None,
    })
}

fn decode(
    job: &LeasedJob,
    log: &DriveLog,
    labels: &JobLabels,
    port: &dyn WorkerPort,
    control: &JobControl,
    plan: &Plan,
) -> Result<BackgroundSet, Error> {
    let every = job.spec.hold_out_every as usize;
    let message = labels.while_decoding("decoding frames");
    let progress = |done: usize, count: usize| {
        let fraction = DECODED * done as f64 / count.max(1) as f64;
        report(control, fraction, "decode", done, count, &message);
        !control.cancelled()
    };
    let (blobs, longer_side_px) = (PortBlobs(port), plan.longer_side_px);
    background_set(log, &blobs, &labels.labels, every, longer_side_px, progress)?
        .ok_or(Error::Cancelled)
}

/// A header with what every asset of a log shares.
pub(super) fn header(log: &DriveLog) -> AssetHeader {
    AssetHeader {
        format_version: FORMAT_VERSION,
        kind: AssetKind::Object,
        class: ObjectClass::Other,
        size_m: DVec3::ZERO,
        symmetric: false,
        usage: Usage::Library,
        usage_reason: String::new(),
        local_from_world: Rigid::IDENTITY,
        source_log: log.id.to_string(),
        source_track_id: String::new(),
        synthetic: log.synthetic,
        quality: Default::default(),
        coverage: None,
        recording: None,
        valid_region: None,
        ego_from_object: Vec::new(),
        color_space: ColorSpace::Srgb,
        exposure_ev: 0.0,
    }
}

/// Encodes an asset and puts its payload on stable storage; the record that names it is written when the job completes.
pub(super) fn publish(
    port: &dyn WorkerPort,
    control: &JobControl,
    header: AssetHeader,
    field: Field,
) -> Result<crate::domain::blob::BlobRef, Error> {
    let before = control.progress();
    report(
        control,
        before.fraction,
        "publish",
        0,
        1,
        "writing the asset",
    );
    let payload = Asset {
        header,
        field: field.into(),
    }
    .encode();
    Ok(port.write_blob(&payload)?)
}
