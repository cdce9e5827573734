//! How good a trained field is, measured on held-out views.

mod coverage;
mod image;
mod render;
mod report;
mod silhouette;

pub use coverage::{AZIMUTH_SECTORS, ViewCoverage};
pub use image::{psnr_db, ssim};
pub use render::{RenderedRay, render_counted, render_rays};
pub use report::QualityReport;
pub use silhouette::SilhouetteFigures;
