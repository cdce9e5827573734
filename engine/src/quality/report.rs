//! The figures stored with every asset.

use serde::{Deserialize, Serialize};

/// Measured on held-out views, which never choose a checkpoint or a setting. Unknown figures are `None`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct QualityReport {
    /// Decibels over the valid pixels of the held-out views: static non-sky ones for a background, inside the mask for an object.
    pub psnr_held_out: Option<f64>,
    pub ssim_held_out: Option<f64>,
    /// Mean absolute range error in metres on held-out views, best 95 %, up to 50 m: against LiDAR, or against depth maps and
    /// points of structure from motion where there is none.
    pub depth_mae_m: Option<f64>,
    pub train_views: u32,
    pub held_out_views: u32,
    /// Frame index of every held-out view, in increasing order.
    pub held_out_frames: Vec<u32>,
    /// Objects: mean accumulation inside the mask, 0..1.
    pub accumulation_in_mask: Option<f64>,
    /// Objects: mean accumulation of background-labelled rays through the padded cuboid, 0..1.
    pub halo: Option<f64>,
    pub train_seconds: f64,
    pub train_rays: u64,
    /// Decibels over the colour rays of the last training steps.
    pub psnr_train: Option<f64>,
    /// Finest voxel in metres.
    pub voxel_size_m: f64,
    pub warnings: Vec<String>,
}
