//! A training run's figures as the asset's record keeps them.

use backlot_engine::quality::{QualityReport as Measured, ViewCoverage};

use crate::domain::asset::QualityReport;

/// The record's report; `coverage` is an object's.
pub(super) fn quality_record(
    measured: &Measured,
    coverage: Option<&ViewCoverage>,
) -> QualityReport {
    QualityReport {
        psnr_held_out: measured.psnr_held_out,
        ssim_held_out: measured.ssim_held_out,
        depth_mae_m: measured.depth_mae_m,
        train_views: measured.train_views,
        held_out_views: measured.held_out_views,
        held_out_frames: measured.held_out_frames.clone(),
        image_size_px: None,
        accumulation_in_mask: measured.accumulation_in_mask,
        halo: measured.halo,
        azimuth_histogram: coverage.map_or_else(Vec::new, |c| c.azimuth_views.to_vec()),
        azimuth_mirrored: coverage.map_or_else(Vec::new, |c| c.azimuth_mirrored.to_vec()),
        train_seconds: measured.train_seconds,
        train_rays: measured.train_rays,
        peak_rss_bytes: peak_rss_bytes(),
        voxel_size_m: measured.voxel_size_m,
        warnings: measured.warnings.clone(),
    }
}

/// Largest resident memory of this process so far; 0 where the system does not say (other than Linux).
fn peak_rss_bytes() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    status
        .lines()
        .find_map(|line| line.strip_prefix("VmHWM:")?.trim().strip_suffix(" kB"))
        .and_then(|kib| kib.parse::<u64>().ok())
        .map_or(0, |kib| kib * 1024)
}
