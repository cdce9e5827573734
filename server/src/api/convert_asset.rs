//! Asset records on the wire.

use backlot_proto::v1;

use super::blobs::blob_to_wire;
use super::convert_drive_log::object_class_to_wire;
use super::time::timestamp;
use crate::domain::asset::{Asset, AssetKind, QualityReport, Usage};

pub(crate) fn asset_to_wire(asset: &Asset) -> v1::Asset {
    let content = &asset.content;
    let (usage, usage_reason) = match &content.usage {
        Usage::Library => (v1::AssetUsage::Library, String::new()),
        Usage::ReplayOnly { reason } => (v1::AssetUsage::ReplayOnly, reason.clone()),
    };
    let kind = match asset.kind() {
        AssetKind::Background => v1::AssetKind::Background,
        AssetKind::Object => v1::AssetKind::Object,
    };
    let object = content.object.as_ref();
    v1::Asset {
        name: asset.id.to_string(),
        kind: kind.into(),
        usage: usage.into(),
        object_class: object
            .map_or(v1::ObjectClass::Unspecified, |object| {
                object_class_to_wire(object.class)
            })
            .into(),
        size_m: object.map(|object| {
            let [x, y, z] = object.size_m;
            v1::Vector3 { x, y, z }
        }),
        source_log: asset.source_log.to_string(),
        source_track_id: object.map_or_else(String::new, |object| object.track_id.clone()),
        job: asset.job.to_string(),
        payload: Some(blob_to_wire(&content.payload)),
        quality: Some(quality_to_wire(&content.quality)),
        synthetic: content.synthetic,
        usage_reason,
        create_time: Some(timestamp(asset.created_at)),
    }
}

/// What was not measured is NaN on the wire.
fn quality_to_wire(quality: &QualityReport) -> v1::QualityReport {
    v1::QualityReport {
        psnr_held_out: quality.psnr_held_out.unwrap_or(f64::NAN),
        ssim_held_out: quality.ssim_held_out.unwrap_or(f64::NAN),
        depth_mae_m: quality.depth_mae_m.unwrap_or(f64::NAN),
        train_views: quality.train_views,
        held_out_views: quality.held_out_views,
        accumulation_in_mask: quality.accumulation_in_mask.unwrap_or(f64::NAN),
        halo: quality.halo.unwrap_or(f64::NAN),
        azimuth_histogram: quality.azimuth_histogram.clone(),
        azimuth_mirrored: quality.azimuth_mirrored.clone(),
        train_seconds: quality.train_seconds,
        train_rays: quality.train_rays,
        peak_rss_bytes: quality.peak_rss_bytes,
        voxel_size_m: quality.voxel_size_m,
        warnings: quality.warnings.clone(),
        held_out_frames: quality.held_out_frames.clone(),
        image_width_px: quality.image_size_px.map_or(0, |size| size.0),
        image_height_px: quality.image_size_px.map_or(0, |size| size.1),
    }
}
