//! Builds a background's valid region from its density field and recording: ground, then pillars above it, then what was seen or driven over.

use glam::{DVec2, DVec3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::density::DensityField;
use super::driven::driven_cells;
use super::ground::{Found, grow_ground};
use super::path::DrivenPath;
use super::pillar::{Pillars, clear_cells};
use super::recording::Recording;
use super::valid_region::{Cell, ValidRegion};

/// How the valid region is found. Densities in 1/m, lengths in metres.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct RegionConfig {
    pub cell_m: f64,
    /// Limits of the largest and of the mean density in a pillar above the ground (eq. 7).
    pub max_sigma: f64,
    pub mean_sigma: f64,
    /// Side of a pillar.
    pub pillar_m: f64,
    pub pillars: Pillars,
    /// The pillar above the ground that an object would fill.
    pub pillar_from_m: f64,
    pub pillar_to_m: f64,
    /// Cells further than this from the driven path are not looked at.
    pub max_lateral_m: f64,
    /// The path is continued straight ahead of the last pose by this much.
    pub ahead_m: f64,
    /// Largest step between neighbouring cells.
    pub max_step_m: f64,
    /// How far ground may lie off the plane of the road under the path: `max_step_m` and this per metre beside the path.
    pub off_plane: f64,
    /// Views in which ground and the space above it must be seen.
    pub min_views: usize,
    /// Views tried per cell, spread evenly over those that might see it.
    pub max_views: usize,
    /// Cells are looked at from at most this far.
    pub view_range_m: f64,
}

impl Default for RegionConfig {
    fn default() -> Self {
        Self {
            cell_m: 0.5,
            max_sigma: PAPER_MAX * UNIT_PER_M,
            mean_sigma: PAPER_MEAN * UNIT_PER_M,
            pillar_m: PAPER_PILLAR_M,
            pillars: Pillars::AnyAround,
            // Below are kerb-high errors of the ground itself.
            pillar_from_m: 0.3,
            pillar_to_m: 1.9,
            max_lateral_m: 8.0,
            ahead_m: 40.0,
            // Half a kerb.
            max_step_m: 0.07,
            // The other side of a crowned road falls away; a kerb of 0.12 m at 5 m is still seen.
            off_plane: 0.01,
            min_views: 2,
            max_views: 8,
            view_range_m: 40.0,
        }
    }
}

/// The paper's delta_1 and delta_2 on pillars of 2 m x 2 m (section 4.2). It states no unit.
const PAPER_MAX: f64 = 30.0;
const PAPER_MEAN: f64 = 15.0;
const PAPER_PILLAR_M: f64 = 2.0;

/// What one of the paper's units stands for here, in 1/m.
///
/// 30 units are then 4/m: a base voxel of 0.25 m that hides 63 % of what is behind it, which is a thing. 15 units are 2/m: a pillar
/// that lets 2 % of the light through its 2 m. `examples/region_thresholds.rs` shows what the thresholds separate on trained
/// backgrounds.
const UNIT_PER_M: f64 = 4.0 / 30.0;

impl RegionConfig {
    /// The paper's thresholds taken on raw units, softplus(raw + shift) per base voxel, on a fixed raster of pillars.
    ///
    /// With a base voxel of 0.25 m they are 120/m and 60/m: only what is solid through and through fails.
    pub fn paper(base_voxel_m: f64) -> Self {
        Self {
            max_sigma: PAPER_MAX / base_voxel_m,
            mean_sigma: PAPER_MEAN / base_voxel_m,
            pillars: Pillars::Raster,
            ..Self::default()
        }
    }
}

/// A ray that stops within this height of a cell's ground has seen it.
const SEEN_HEIGHT_M: f64 = 0.2;
/// The space above the ground is seen if a ray reaches this height over it.
const BODY_HEIGHT_M: f64 = 0.8;
const BODY_TOLERANCE_M: f64 = 0.3;
/// Nearer ground is under the hood.
const MIN_VIEW_M: f64 = 3.0;

impl ValidRegion {
    /// Finds ground, clearance and what was seen. A recording without frames, or a field without a road under the path, gives a
    /// region without free cells.
    pub fn build(field: &dyn DensityField, recording: &Recording, config: &RegionConfig) -> Self {
        let Some(path) = DrivenPath::new(recording, config.ahead_m) else {
            return Self::unseen(DVec2::ZERO, config.cell_m, 0, 0);
        };
        let mut region = grid(field, &path, config);
        let Some(mut found) = grow_ground(field, &path, config, &mut region) else {
            return region;
        };
        let driven = driven_cells(recording, &path, config, &mut region, &mut found);
        let clear = clear_cells(field, config, &region, &found);
        let cells = (0..found.len())
            .into_par_iter()
            .map(|cell| match found[cell] {
                Found::Nothing => Cell::Unseen,
                _ if !clear[cell] => Cell::Blocked,
                Found::Step => Cell::Uneven,
                Found::Hole(_) => Cell::Unseen,
                Found::Ground if driven[cell] => Cell::Free,
                Found::Ground if is_seen(field, recording, config, &region, cell) => Cell::Free,
                Found::Ground => Cell::Unseen,
            })
            .collect();
        region.cells = cells;
        region
    }
}

fn grid(field: &dyn DensityField, path: &DrivenPath, config: &RegionConfig) -> ValidRegion {
    let (low, high) = field.bounds();
    let margin = DVec2::splat(config.max_lateral_m);
    let points = path.points().iter().map(|p| p.truncate());
    let min = points.clone().reduce(DVec2::min).unwrap_or_default() - margin;
    let max = points.reduce(DVec2::max).unwrap_or_default() + margin;
    let min = (min.max(low.truncate()) / config.cell_m).floor() * config.cell_m;
    let size = (max.min(high.truncate()) - min).max(DVec2::ZERO) / config.cell_m;
    ValidRegion::unseen(
        min,
        config.cell_m,
        size.x.ceil() as usize,
        size.y.ceil() as usize,
    )
}

/// Whether enough recorded views see the cell's ground and the space above it: unseen is not free, nor is what a wall hides.
fn is_seen(
    field: &dyn DensityField,
    recording: &Recording,
    config: &RegionConfig,
    region: &ValidRegion,
    cell: usize,
) -> bool {
    let ground = region.centre(cell).extend(region.ground_m[cell]);
    let body = ground + DVec3::Z * BODY_HEIGHT_M;
    let eyes: Vec<DVec3> = recording
        .frames
        .iter()
        .filter(|frame| {
            let p = frame.local_from_camera.inverse().point(ground);
            let range = p.length();
            let camera = recording.camera(&frame.camera_id);
            let pixel = camera.and_then(|c| Some((c, c.project(p)?)));
            (MIN_VIEW_M..config.view_range_m).contains(&range)
                && pixel.is_some_and(|(c, px)| {
                    px.x >= 0.0
                        && px.y >= 0.0
                        && px.x < f64::from(c.width)
                        && px.y < f64::from(c.height)
                })
        })
        .map(|frame| frame.local_from_camera.translation_m)
        .collect();
    let tried = eyes.len().min(config.max_views);
    let mut seen = 0;
    for i in 0..tried {
        let eye = eyes[i * eyes.len() / tried];
        if sees_ground(field, eye, ground) && sees_body(field, eye, body) {
            seen += 1;
        }
        if seen >= config.min_views {
            return true;
        }
    }
    false
}

fn sees_ground(field: &dyn DensityField, eye: DVec3, ground: DVec3) -> bool {
    let offset = ground - eye;
    let range = offset.length();
    let direction = offset / range;
    // A grazing ray that dips under a slightly low surface stops later than the target.
    let reach = range + 10.0;
    field
        .hit(eye, direction, reach)
        .is_some_and(|t| (eye.z + direction.z * t - ground.z).abs() <= SEEN_HEIGHT_M)
}

fn sees_body(field: &dyn DensityField, eye: DVec3, body: DVec3) -> bool {
    let offset = body - eye;
    let range = offset.length();
    field
        .hit(eye, offset / range, range - BODY_TOLERANCE_M)
        .is_none()
}
