//! Figures on held-out frames and of the process.

use std::path::Path;
use std::sync::Arc;

use anyhow::{Context, Result};
use backlot_engine::asset::{AssetHeader, AssetKind, ColorSpace, FORMAT_VERSION, Usage};
use backlot_engine::camera::Rigid;
use backlot_engine::class::ObjectClass;
use backlot_engine::field::Ray;
use backlot_engine::quality::{psnr_db, render_rays};
use backlot_engine::train::Trained;
use backlot_engine::view::{PixelLabel, Split, TrainView};
use backlot_engine::{Asset, Field};
use glam::DVec3;
use serde::Serialize;

/// What `--json` writes. Looking is not counted as training.
#[derive(Serialize)]
pub(crate) struct Report {
    pub(crate) train_s: f64,
    pub(crate) steps: u64,
    pub(crate) rays: u64,
    /// Over the pixels of the held-out frames that are not sky or movers.
    pub(crate) psnr_held_out: Option<f64>,
    pub(crate) ssim_held_out: Option<f64>,
    pub(crate) depth_mae_m: Option<f64>,
    pub(crate) psnr_train: Option<f64>,
    pub(crate) peak_rss_mib: f64,
    pub(crate) field_mib: f64,
    /// Of the stored asset, and the held-out figure of what is read back from it.
    pub(crate) asset_mb: Option<f64>,
    pub(crate) psnr_stored: Option<f64>,
    pub(crate) voxel_size_m: f64,
    pub(crate) warnings: Vec<String>,
    pub(crate) progress: Vec<Moment>,
}

#[derive(Serialize)]
pub(crate) struct Moment {
    pub(crate) train_s: f64,
    pub(crate) psnr_held_out: f64,
}

/// As the quality report of a background: over all foreground pixels of the held-out views, in 8 bits.
pub(crate) fn psnr_held_out(field: &Field, views: &[TrainView]) -> f64 {
    let (mut squares, mut pixels) = (0.0, 0_u64);
    for view in views.iter().filter(|view| view.split == Split::HeldOut) {
        for (shown, (actual, label)) in render(field, view)
            .iter()
            .zip(view.rgb.chunks_exact(3).zip(&view.labels))
        {
            if *label == PixelLabel::Foreground {
                pixels += 3;
                let pairs = shown.iter().zip(actual);
                squares += pairs
                    .map(|(a, b)| (f64::from(*a) - f64::from(*b)).powi(2) / 65_025.0)
                    .sum::<f64>();
            }
        }
    }
    psnr_db(squares / pixels as f64)
}

fn render(field: &Field, view: &TrainView) -> Vec<[u8; 3]> {
    let pixels = 0..view.camera.pixel_count();
    let rays: Vec<Ray> = pixels.map(|at| view.pixel_ray(at)).collect();
    let byte = |c: f32| (c.clamp(0.0, 1.0) * 255.0).round() as u8;
    let rendered = render_rays(field, &rays);
    rendered.iter().map(|ray| ray.color.map(byte)).collect()
}

/// Writes each held-out frame, recorded above rendered.
pub(crate) fn write_views(field: &Field, views: &[TrainView], folder: &Path) -> Result<()> {
    std::fs::create_dir_all(folder)
        .with_context(|| format!("{}: cannot be created", folder.display()))?;
    for view in views.iter().filter(|view| view.split == Split::HeldOut) {
        let both: Vec<u8> = view
            .rgb
            .iter()
            .copied()
            .chain(render(field, view).into_iter().flatten())
            .collect();
        let path = folder.join(format!("frame_{:03}.png", view.frame_index));
        let (width, height) = (view.camera.width, 2 * view.camera.height);
        image::save_buffer(&path, &both, width, height, image::ExtendedColorType::Rgb8)
            .with_context(|| format!("{}: cannot be written", path.display()))?;
    }
    Ok(())
}

/// The asset as it is stored; recording and valid region, a few kilobytes, are not in it.
pub(crate) fn stored(trained: Trained) -> Vec<u8> {
    let header = AssetHeader {
        format_version: FORMAT_VERSION,
        kind: AssetKind::Background,
        class: ObjectClass::Other,
        size_m: DVec3::ZERO,
        symmetric: false,
        usage: Usage::Library,
        usage_reason: String::new(),
        local_from_world: Rigid::IDENTITY,
        source_log: "street".to_owned(),
        source_track_id: String::new(),
        synthetic: true,
        quality: trained.quality,
        coverage: None,
        recording: None,
        valid_region: None,
        ego_from_object: Vec::new(),
        color_space: ColorSpace::Srgb,
        exposure_ev: 0.0,
    };
    let asset = Asset {
        header,
        field: Arc::new(trained.field),
    };
    asset.encode()
}

/// Largest resident set of this process in MiB, with the street's making; 0 where the system does not tell.
pub(crate) fn peak_rss_mib() -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    let kib = line.and_then(|line| line.split_whitespace().next()?.parse::<f64>().ok());
    kib.unwrap_or(0.0) / 1024.0
}
