//! Which frames of which tracks are good enough to reconstruct an object from, by geometry alone.

use std::collections::BTreeMap;

use backlot_engine::camera::{Camera, NEAR_M, Rigid};
use backlot_engine::class::ObjectClass;
use glam::DVec2;
use serde::{Deserialize, Serialize};

use super::background::time_order;
use super::background_labels::moving_tracks;
use super::hull::{area, bounds, corners, cuboid_hull, raster};
use crate::domain::drive_log::{CameraFrame, DriveLog, Occlusion};

/// Projected cuboids smaller than this, in pixels, teach nothing.
const LEAST_AREA_PX: f64 = 400.0;
/// Cuboids may reach this far over the image border: annotations are loose.
const BORDER_PX: f64 = 1.0;
/// Nearer cuboids may cover this much of the projected cuboid, whose corners the object does not fill.
const MOST_COVERED: f64 = 0.2;
/// The data set's own truncation beyond which an object is not whole.
const MOST_TRUNCATED: f32 = 0.05;

/// Why a frame of a track is not used.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Rejection {
    OutsideImage,
    Truncated,
    TooSmall,
    Occluded,
    NoMask,
    MergedMask,
    InconsistentMask,
    #[serde(rename = "few_lidar_returns")]
    FewReturns,
}

impl Rejection {
    /// Name in reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::OutsideImage => "outside_image",
            Self::Truncated => "truncated",
            Self::TooSmall => "too_small",
            Self::Occluded => "occluded",
            Self::NoMask => "no_mask",
            Self::MergedMask => "merged_mask",
            Self::InconsistentMask => "inconsistent_mask",
            Self::FewReturns => "few_lidar_returns",
        }
    }
}

/// How often each reason was found.
pub type Rejections = BTreeMap<Rejection, u32>;

/// The frames of one track that show the whole object.
#[derive(Clone, Debug, PartialEq)]
pub struct TrackPlan {
    /// Index into the log's tracks.
    pub track: usize,
    pub moving: bool,
    /// Indices into the log's frames, in time order.
    pub frames: Vec<usize>,
    pub rejected: Rejections,
    /// Projected area over the usable frames: what the reconstruction can gain from.
    pub area_px: f64,
}

/// One plan for every track, those with most pixels first. Labelled things without a class of their own never become assets.
pub fn plan_objects(log: &DriveLog) -> Vec<TrackPlan> {
    let mut plans: Vec<TrackPlan> = moving_tracks(log)
        .into_iter()
        .enumerate()
        .map(|(track, moving)| TrackPlan {
            track,
            moving,
            frames: Vec::new(),
            rejected: Rejections::new(),
            area_px: 0.0,
        })
        .collect();
    for index in time_order(log) {
        let frame = &log.frames[index];
        let Some(camera) = log.camera(&frame.camera_id) else {
            continue;
        };
        let seen = outlines(log, frame, &camera.camera);
        for outline in &seen {
            let plan = &mut plans[outline.track];
            match assess(log, frame, &camera.camera, outline, &seen) {
                Ok(area_px) => {
                    plan.frames.push(index);
                    plan.area_px += area_px;
                }
                Err(reason) => *plan.rejected.entry(reason).or_default() += 1,
            }
        }
    }
    plans.retain(|plan| log.tracks[plan.track].class != ObjectClass::Other);
    plans.sort_by(|a, b| b.area_px.total_cmp(&a.area_px).then(a.track.cmp(&b.track)));
    plans
}

/// A track's cuboid in one image.
#[derive(Clone, Debug)]
pub(super) struct Outline {
    pub track: usize,
    pub hull: Vec<DVec2>,
    /// Camera centre to cuboid centre in metres, the order of occlusion.
    pub distance_m: f64,
    pub camera_from_cuboid: Rigid,
}

/// The cuboids that are in front of the camera at the frame's time.
pub(super) fn outlines(log: &DriveLog, frame: &CameraFrame, camera: &Camera) -> Vec<Outline> {
    let Some(world_from_camera) = log.world_from_camera(frame) else {
        return Vec::new();
    };
    let camera_from_world = world_from_camera.inverse();
    let outline = |track: usize| {
        let known = &log.tracks[track];
        let pose = camera_from_world * known.at(frame.timestamp_ns)?;
        let hull = cuboid_hull(camera, &pose, known.size_m);
        (hull.len() > 2).then(|| Outline {
            track,
            hull,
            distance_m: pose.translation_m.length(),
            camera_from_cuboid: pose,
        })
    };
    (0..log.tracks.len()).filter_map(outline).collect()
}

/// The projected area in pixels if the frame shows the whole object.
pub(super) fn assess(
    log: &DriveLog,
    frame: &CameraFrame,
    camera: &Camera,
    outline: &Outline,
    seen: &[Outline],
) -> Result<f64, Rejection> {
    let size = DVec2::new(f64::from(camera.width), f64::from(camera.height));
    let (lo, hi) = bounds(&outline.hull).ok_or(Rejection::OutsideImage)?;
    if hi.cmple(DVec2::ZERO).any() || lo.cmpge(size).any() {
        return Err(Rejection::OutsideImage);
    }
    let track = &log.tracks[outline.track];
    let state = track.nearest_state(frame.timestamp_ns);
    let cut_by_near_plane = corners(&outline.camera_from_cuboid, track.size_m)
        .iter()
        .any(|c| c.z < NEAR_M);
    let over_border =
        lo.cmplt(DVec2::splat(-BORDER_PX)).any() || hi.cmpgt(size + DVec2::splat(BORDER_PX)).any();
    let annotated = state.is_some_and(|s| s.truncation > MOST_TRUNCATED);
    if cut_by_near_plane || over_border || annotated {
        return Err(Rejection::Truncated);
    }
    let area_px = area(&outline.hull);
    if area_px < LEAST_AREA_PX {
        return Err(Rejection::TooSmall);
    }
    let annotated = state.is_some_and(|s| s.occlusion == Occlusion::Largely);
    if annotated || covered_fraction(outline, seen, camera) > MOST_COVERED {
        return Err(Rejection::Occluded);
    }
    Ok(area_px)
}

/// The fraction of the outline that nearer outlines cover.
fn covered_fraction(outline: &Outline, seen: &[Outline], camera: &Camera) -> f64 {
    let (width, height) = (camera.width, camera.height);
    let mut inside = Inside::of(&outline.hull, width, height);
    let total = inside.count();
    for nearer in seen {
        if nearer.distance_m < outline.distance_m {
            raster(&nearer.hull, width, height, |row, columns| {
                inside.clear(row, columns);
            });
        }
    }
    1.0 - inside.count() as f64 / total.max(1) as f64
}

/// The pixels of a hull, held for its bounding rows and columns only.
struct Inside {
    first_row: usize,
    first_column: usize,
    width: usize,
    pixels: Vec<bool>,
}

impl Inside {
    fn of(hull: &[DVec2], width: u32, height: u32) -> Self {
        // First and end of rows and columns; nothing while the first is past the end.
        let (mut top, mut bottom, mut left, mut right) = (usize::MAX, 0, usize::MAX, 0);
        raster(hull, width, height, |row, columns| {
            (top, bottom) = (top.min(row), bottom.max(row + 1));
            (left, right) = (left.min(columns.start), right.max(columns.end));
        });
        let (columns, rows) = (right.saturating_sub(left), bottom.saturating_sub(top));
        let mut inside = Self {
            first_row: top,
            first_column: left,
            width: columns,
            pixels: vec![false; rows * columns],
        };
        raster(hull, width, height, |row, c| inside.set(row, c, true));
        inside
    }

    fn set(&mut self, row: usize, columns: std::ops::Range<usize>, value: bool) {
        let Some(row) = row.checked_sub(self.first_row) else {
            return;
        };
        let start = columns.start.saturating_sub(self.first_column);
        let end = columns
            .end
            .saturating_sub(self.first_column)
            .min(self.width);
        let row_start = row * self.width;
        if start < end && row_start < self.pixels.len() {
            self.pixels[row_start + start..row_start + end].fill(value);
        }
    }

    fn clear(&mut self, row: usize, columns: std::ops::Range<usize>) {
        self.set(row, columns, false);
    }

    fn count(&self) -> usize {
        self.pixels.iter().filter(|&&p| p).count()
    }
}
