//! Figures on test views and of the process.

use std::path::Path;
use std::time::Instant;

use anyhow::{Context, Result};
use backlot_engine::Field;
use backlot_engine::field::Ray;
use backlot_engine::quality::{psnr_db, render_rays, ssim};
use backlot_engine::view::TrainView;
use serde::Serialize;

/// What `--json` writes.
#[derive(Serialize)]
pub(crate) struct Report {
    /// Evaluation not counted.
    pub(crate) train_s: f64,
    pub(crate) iters: u64,
    pub(crate) rays: u64,
    pub(crate) rays_per_s: f64,
    pub(crate) psnr_test: f64,
    pub(crate) ssim_test: f64,
    /// Median over the test views.
    pub(crate) render_ms_per_frame: f64,
    pub(crate) peak_rss_mib: f64,
    pub(crate) field_mib: f64,
    pub(crate) progress: Vec<Moment>,
}

#[derive(Serialize)]
pub(crate) struct Moment {
    pub(crate) train_s: f64,
    pub(crate) psnr_test: f64,
}

/// Rendered test views, 8 bit, and means over them.
pub(crate) struct TestFigures {
    pub(crate) psnr: f64,
    pub(crate) ssim: f64,
    pub(crate) ms_per_frame: f64,
    images: Vec<(u32, u32, Vec<u8>)>,
}

/// Renders every view over `behind` and compares what an 8-bit file would hold.
pub(crate) fn test_figures(field: &Field, views: &[TrainView], behind: [f32; 3]) -> TestFigures {
    let (mut psnr, mut similarity) = (0.0, 0.0);
    let (mut milliseconds, mut images) = (Vec::new(), Vec::new());
    for view in views {
        let start = Instant::now();
        let image = render(field, view, behind);
        milliseconds.push(start.elapsed().as_secs_f64() * 1e3);
        let pairs = image.iter().zip(&view.rgb);
        let squares = pairs.map(|(a, b)| (f64::from(*a) - f64::from(*b)).powi(2) / 65_025.0);
        psnr += psnr_db(squares.sum::<f64>() / image.len() as f64);
        let (width, height) = (view.camera.width, view.camera.height);
        let everywhere = vec![true; view.camera.pixel_count()];
        let (a, b) = (unit(&image), unit(&view.rgb));
        let windows = ssim(width as usize, height as usize, &a, &b, &everywhere);
        similarity += windows.unwrap_or(f64::NAN);
        images.push((width, height, image));
    }
    milliseconds.sort_by(f64::total_cmp);
    TestFigures {
        psnr: psnr / views.len() as f64,
        ssim: similarity / views.len() as f64,
        ms_per_frame: milliseconds[milliseconds.len() / 2],
        images,
    }
}

fn render(field: &Field, view: &TrainView, behind: [f32; 3]) -> Vec<u8> {
    let pixels = 0..view.camera.pixel_count();
    let rays: Vec<Ray> = pixels.map(|at| view.pixel_ray(at)).collect();
    let rendered = render_rays(field, &rays);
    let bytes = rendered.iter().flat_map(|ray| {
        let left = 1.0 - ray.accumulation;
        [0, 1, 2].map(|c| (ray.color[c] + left * behind[c]).clamp(0.0, 1.0) * 255.0)
    });
    bytes.map(|c| c.round() as u8).collect()
}

fn unit(image: &[u8]) -> Vec<[f32; 3]> {
    let pixels = image.chunks_exact(3);
    pixels
        .map(|p| [p[0], p[1], p[2]].map(|c| f32::from(c) / 255.0))
        .collect()
}

impl TestFigures {
    /// Writes r_K.png for view K.
    pub(crate) fn write(&self, folder: &Path) -> Result<()> {
        std::fs::create_dir_all(folder)
            .with_context(|| format!("{}: cannot be created", folder.display()))?;
        for (number, (width, height, rgb)) in self.images.iter().enumerate() {
            let path = folder.join(format!("r_{number}.png"));
            image::save_buffer(&path, rgb, *width, *height, image::ExtendedColorType::Rgb8)
                .with_context(|| format!("{}: cannot be written", path.display()))?;
        }
        Ok(())
    }
}

/// Largest resident set of this process in MiB, 0 where the system does not tell.
pub(crate) fn peak_rss_mib() -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    let kib = line.and_then(|line| line.split_whitespace().next()?.parse::<f64>().ok());
    kib.unwrap_or(0.0) / 1024.0
}
