//! `report.json`: the figures of a run.

use std::collections::BTreeMap;
use std::path::Path;

use backlot_proto::v1;
use serde::Serialize;

use super::exact::ExactComparison;
use super::figures::{mean, median};
use super::held_out::HeldOutFrame;
use super::library::Library;
use super::stages::Stages;
use super::{machine, sample_boxes};
use crate::output::measured;

/// PSNR in decibels, lengths in metres. Figures of images are recomputed from the written files.
#[derive(Debug, Serialize)]
pub(crate) struct Report {
    pub dataset: String,
    /// The log was generated: its images are ray-traced.
    pub synthetic: bool,
    pub background: BackgroundReport,
    pub objects: Vec<ObjectReport>,
    pub samples: usize,
    /// Mean over the samples; generated logs only, as all that follow from the exact counterparts.
    pub sample_psnr_vs_exact: Option<f64>,
    pub sample_psnr_vs_exact_min: Option<f64>,
    pub insert_psnr_vs_exact: Option<f64>,
    pub insert_mask_iou_median: Option<f64>,
    pub visible_box_iou_median: Option<f64>,
    pub sample_details: Vec<ExactComparison>,
    pub placements: Placements,
    pub stage_seconds: serde_json::Value,
    pub total_seconds: f64,
    pub cpu_seconds: Option<f64>,
    pub peak_rss_mib: Option<f64>,
    /// What the reader ignored or assumed, and what training warned of.
    pub notes: Vec<String>,
}

#[derive(Debug, Serialize)]
pub(crate) struct BackgroundReport {
    pub asset: String,
    /// Mean over the held-out frames, static pixels without sky.
    pub psnr_held_out: Option<f64>,
    /// The same over every pixel that is not sky, movers replayed.
    pub psnr_held_out_with_movers: Option<f64>,
    /// Mean of the best neighbouring frame warped by exact depth, on the pixels of `psnr_held_out`.
    pub psnr_warp_baseline: Option<f64>,
    /// Against exact depth where the log is generated, otherwise the trainer's figure against LiDAR.
    pub depth_mae_m: Option<f64>,
    pub depth_mae_against: &'static str,
    /// As the trainer measured it.
    pub psnr_held_out_in_training: Option<f64>,
    pub voxel_size_m: f64,
    pub bytes: u64,
    pub held_out: Vec<HeldOutFrame>,
}

#[derive(Debug, Serialize)]
pub(crate) struct ObjectReport {
    pub asset: String,
    pub class: String,
    /// Inside the exact mask on held-out frames where the log is generated, otherwise the trainer's figure.
    pub psnr_held_out: Option<f64>,
    /// As the trainer measured it.
    pub psnr_held_out_in_training: Option<f64>,
    pub usage: String,
    pub usage_reason: String,
    pub source_log: String,
    pub track: String,
    pub synthetic: bool,
}

#[derive(Debug, Default, Serialize)]
pub(crate) struct Placements {
    pub accepted: u32,
    pub rejected: BTreeMap<String, u32>,
    /// Boxes of all samples by origin, e.g. "replayed".
    pub boxes: BTreeMap<&'static str, u32>,
}

/// Everything a report is made from.
pub(crate) struct Findings<'a> {
    pub log: &'a v1::DriveLog,
    pub library: &'a Library,
    pub held_out: Vec<HeldOutFrame>,
    /// By asset name.
    pub object_psnr: BTreeMap<String, f64>,
    pub samples: &'a [v1::Sample],
    pub exact: Vec<ExactComparison>,
    pub stages: &'a Stages,
    pub notes: Vec<String>,
}

impl Report {
    pub(crate) fn new(findings: Findings<'_>) -> Self {
        let exact = &findings.exact;
        let psnr = || exact.iter().map(|e| e.psnr);
        Self {
            dataset: findings.log.dataset.clone(),
            synthetic: findings.log.synthetic,
            background: background(&findings.library.background, findings.held_out),
            objects: objects(findings.library, &findings.object_psnr),
            samples: findings.samples.len(),
            sample_psnr_vs_exact: mean(psnr()),
            sample_psnr_vs_exact_min: psnr().reduce(f64::min),
            insert_psnr_vs_exact: mean(exact.iter().filter_map(|e| e.psnr_in_insert_mask)),
            insert_mask_iou_median: median(exact.iter().filter_map(|e| e.insert_mask_iou)),
            visible_box_iou_median: median(exact.iter().flat_map(|e| e.visible_box_iou.clone())),
            placements: placements(findings.samples),
            sample_details: findings.exact,
            stage_seconds: findings.stages.to_json(),
            total_seconds: findings.stages.total(),
            cpu_seconds: machine::cpu_seconds(),
            peak_rss_mib: machine::peak_rss_mib(),
            notes: findings.notes,
        }
    }

    pub(crate) fn write(&self, path: &Path) -> anyhow::Result<()> {
        std::fs::write(path, serde_json::to_string_pretty(self)? + "\n")?;
        Ok(())
    }
}

fn background(asset: &v1::Asset, held_out: Vec<HeldOutFrame>) -> BackgroundReport {
    let quality = asset.quality.clone().unwrap_or_default();
    let exact_depth = mean(held_out.iter().filter_map(|f| f.depth_mae_m));
    BackgroundReport {
        asset: asset.name.clone(),
        psnr_held_out: mean(held_out.iter().map(|f| f.psnr)),
        psnr_held_out_with_movers: mean(held_out.iter().map(|f| f.psnr_with_movers)),
        psnr_warp_baseline: mean(held_out.iter().filter_map(|f| f.psnr_warp_baseline)),
        depth_mae_m: exact_depth.or(measured(quality.depth_mae_m)),
        depth_mae_against: if exact_depth.is_some() {
            "exact depth"
        } else {
            "LiDAR"
        },
        psnr_held_out_in_training: measured(quality.psnr_held_out),
        voxel_size_m: quality.voxel_size_m,
        bytes: asset.payload.as_ref().map_or(0, |blob| blob.size_bytes),
        held_out,
    }
}

fn objects(library: &Library, psnr: &BTreeMap<String, f64>) -> Vec<ObjectReport> {
    let all = library.objects.iter().chain(&library.supplied);
    all.map(|asset| {
        let in_training = measured(asset.quality.as_ref().map_or(f64::NAN, |q| q.psnr_held_out));
        ObjectReport {
            asset: asset.name.clone(),
            class: asset
                .object_class()
                .as_str_name()
                .replace("OBJECT_CLASS_", ""),
            psnr_held_out: psnr.get(&asset.name).copied().or(in_training),
            psnr_held_out_in_training: in_training,
            usage: asset.usage().as_str_name().replace("ASSET_USAGE_", ""),
            usage_reason: asset.usage_reason.clone(),
            source_log: asset.source_log.clone(),
            track: asset.source_track_id.clone(),
            synthetic: asset.synthetic,
        }
    })
    .collect()
}

fn placements(samples: &[v1::Sample]) -> Placements {
    let mut placements = Placements::default();
    for sample in samples {
        for (origin, count) in sample_boxes(sample) {
            *placements.boxes.entry(origin).or_default() += count;
            if matches!(origin, "inserted" | "replaced" | "moved") {
                placements.accepted += count;
            }
        }
        for (reason, count) in &sample.rejections {
            *placements.rejected.entry(reason.clone()).or_default() += count;
        }
    }
    placements
}
