//! Figures on held-out frames and of the process.

use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;

use anyhow::{Context, Result};
use backlot_client::generator::StreetWorld;
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

use crate::seen::seen_pixels;

/// What `--json` writes. Looking is not counted as training.
#[derive(Serialize)]
pub(crate) struct Report {
    pub(crate) train_s: f64,
    pub(crate) steps: u64,
    pub(crate) rays: u64,
    /// Over the pixels of the held-out frames that are not sky or movers.
    pub(crate) psnr_held_out: Option<f64>,
    /// Of those, over the ones whose surface some training frame shows.
    pub(crate) psnr_seen: f64,
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
    pub(crate) psnr_seen: f64,
}

/// The held-out frames, and which of their pixels show what training frames show.
pub(crate) struct HeldOut<'a> {
    views: &'a [TrainView],
    seen: HashMap<u32, Vec<bool>>,
}

/// As the quality report of a background: over foreground pixels, in 8 bits.
#[derive(Clone, Copy)]
pub(crate) struct Psnr {
    pub(crate) all: f64,
    /// Of surfaces that some training frame shows.
    pub(crate) seen: f64,
}

impl<'a> HeldOut<'a> {
    pub(crate) fn new(world: &StreetWorld, views: &'a [TrainView]) -> Result<Self> {
        let seen = seen_pixels(world, views)?;
        let held_out = Self { views, seen };
        let (mut static_pixels, mut of_them_seen) = (0, 0);
        for view in held_out.frames() {
            for (label, seen) in view.labels.iter().zip(&held_out.seen[&view.frame_index]) {
                static_pixels += usize::from(*label == PixelLabel::Foreground);
                of_them_seen += usize::from(*label == PixelLabel::Foreground && *seen);
            }
        }
        eprintln!(
            "{of_them_seen} of {static_pixels} held-out pixels show what training frames show"
        );
        Ok(held_out)
    }

    pub(crate) fn psnr(&self, field: &Field) -> Psnr {
        let (mut all, mut of_seen) = ((0.0, 0_u64), (0.0, 0_u64));
        for view in self.frames() {
            let pixels = view.rgb.chunks_exact(3).zip(&view.labels);
            let pixels = pixels.zip(&self.seen[&view.frame_index]);
            for (shown, ((actual, label), seen)) in render(field, view).iter().zip(pixels) {
                if *label != PixelLabel::Foreground {
                    continue;
                }
                let pairs = shown.iter().zip(actual);
                let squares =
                    pairs.map(|(a, b)| (f64::from(*a) - f64::from(*b)).powi(2) / 65_025.0);
                let squares: f64 = squares.sum();
                all = (all.0 + squares, all.1 + 3);
                if *seen {
                    of_seen = (of_seen.0 + squares, of_seen.1 + 3);
                }
            }
        }
        let psnr = |(squares, count): (f64, u64)| psnr_db(squares / count as f64);
        Psnr {
            all: psnr(all),
            seen: psnr(of_seen),
        }
    }

    /// Writes each held-out frame, recorded above rendered.
    pub(crate) fn write(&self, field: &Field, folder: &Path) -> Result<()> {
        std::fs::create_dir_all(folder)
            .with_context(|| format!("{}: cannot be created", folder.display()))?;
        for view in self.frames() {
            let rendered = render(field, view);
            let both: Vec<u8> = view
                .rgb
                .iter()
                .copied()
                .chain(rendered.into_iter().flatten())
                .collect();
            let path = folder.join(format!("frame_{:03}.png", view.frame_index));
            let (width, height) = (view.camera.width, 2 * view.camera.height);
            image::save_buffer(&path, &both, width, height, image::ExtendedColorType::Rgb8)
                .with_context(|| format!("{}: cannot be written", path.display()))?;
        }
        Ok(())
    }

    fn frames(&self) -> impl Iterator<Item = &TrainView> {
        self.views
            .iter()
            .filter(|view| view.split == Split::HeldOut)
    }
}

fn render(field: &Field, view: &TrainView) -> Vec<[u8; 3]> {
    let pixels = 0..view.camera.pixel_count();
    let rays: Vec<Ray> = pixels.map(|at| view.pixel_ray(at)).collect();
    let byte = |c: f32| (c.clamp(0.0, 1.0) * 255.0).round() as u8;
    let rendered = render_rays(field, &rays);
    rendered.iter().map(|ray| ray.color.map(byte)).collect()
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
