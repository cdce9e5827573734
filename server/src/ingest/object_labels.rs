//! What each pixel around an object is to its field: the object, provably not the object, or unknown.
//!
//! With an instance mask the mask decides. Without one, LiDAR returns on the object span what is surely object, the
//! projected cuboid bounds what may be, and the band between the two stays unknown: hulls of returns lose glass and edges, and
//! calling those background would carve the object.

use backlot_engine::camera::Camera;
use backlot_engine::view::PixelLabel;
use glam::{DVec2, DVec3};
use serde::{Deserialize, Serialize};

use super::frame::LoadedFrame;
use super::hull::{cuboid_hull, raster};
use super::object_plan::Outline;
use super::projected::ProjectedReturn;
use crate::domain::drive_log::{MASK_NONE, MASK_UNKNOWN};

/// Returns this close to the cuboid's bottom are ground.
pub(super) const GROUND_BAND_M: f64 = 0.2;
/// The projected cuboid is grown by this on every side before its outside counts as background.
const CUBOID_MARGIN_M: f64 = 0.1;
/// Pixels below the object that its contact shadow darkens.
const CONTACT_PX: usize = 2;
/// Objects narrower than this lose too much to an unknown rim.
const RIM_LEAST_PX: usize = 40;
/// Slack in metres before a return counts as nearer or farther than the cuboid.
const DEPTH_SLACK_M: f64 = 0.3;
/// Half the angular extent in radians of what one return stands for.
const RETURN_X_RAD: f64 = 0.002;
const RETURN_Y_RAD: f64 = 0.005;

/// A rectangle of the image: the object and its surroundings.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Crop {
    pub x: usize,
    pub y: usize,
    pub width: usize,
    pub height: usize,
}

/// Everything needed to label one object in one frame.
pub(super) struct Subject<'a> {
    pub loaded: &'a LoadedFrame,
    pub outline: &'a Outline,
    /// Every cuboid in the image.
    pub seen: &'a [Outline],
    pub size_m: DVec3,
    pub crop: Crop,
}

impl Subject<'_> {
    /// Labels of the crop's pixels from the instance mask, row-major.
    pub(super) fn labels_from_mask(&self, mask: &[u16]) -> Vec<PixelLabel> {
        let mut labels = Vec::with_capacity(self.crop.width * self.crop.height);
        for y in 0..self.crop.height {
            let start = (self.crop.y + y) * self.image_width() + self.crop.x;
            let row = &mask[start..][..self.crop.width];
            labels.extend(row.iter().map(|&value| self.label_of(value)));
        }
        self.contact_below(&mut labels);
        let foreground_columns = (0..self.crop.width)
            .filter(|x| {
                (0..self.crop.height)
                    .any(|y| labels[y * self.crop.width + x] == PixelLabel::Foreground)
            })
            .count();
        if foreground_columns >= RIM_LEAST_PX {
            rim_unknown(&mut labels, self.crop.width);
        }
        self.unmasked_unknown(&mut labels);
        self.nearer_unknown(&mut labels);
        labels
    }

    fn label_of(&self, value: u16) -> PixelLabel {
        if value == MASK_NONE {
            return PixelLabel::Background;
        }
        let track = usize::from(value) - 1;
        if value != MASK_UNKNOWN && track == self.outline.track {
            return PixelLabel::Foreground;
        }
        let is_behind = self
            .seen
            .iter()
            .any(|o| o.track == track && o.distance_m > self.outline.distance_m);
        if is_behind {
            PixelLabel::Background
        } else {
            PixelLabel::Unknown
        }
    }

    /// A nearer object whose mask was missed or refused hides what the mask calls empty.
    fn unmasked_unknown(&self, labels: &mut [PixelLabel]) {
        for nearer in self.seen {
            let is_unmasked = self.loaded.unmasked.contains_key(&nearer.track);
            if is_unmasked && nearer.distance_m < self.outline.distance_m {
                self.visit(&nearer.hull, labels, |label| {
                    if *label == PixelLabel::Background {
                        *label = PixelLabel::Unknown;
                    }
                });
            }
        }
    }

    /// Labels from LiDAR returns and cuboids.
    pub(super) fn labels_from_returns(&self) -> Vec<PixelLabel> {
        let (width, height) = (self.crop.width, self.crop.height);
        let mut labels = vec![PixelLabel::Background; width * height];
        let grown = self.size_m + DVec3::splat(2.0 * CUBOID_MARGIN_M);
        let camera = &self.loaded.camera;
        let may_be = cuboid_hull(camera, &self.outline.camera_from_cuboid, grown);
        self.fill(&may_be, &mut labels, PixelLabel::Unknown);
        let object = self.object_spans();
        self.farther_background(&mut labels, &object);
        for (label, &is_object) in labels.iter_mut().zip(&object) {
            if is_object {
                *label = PixelLabel::Foreground;
            }
        }
        for nearer in self.seen {
            if nearer.distance_m < self.outline.distance_m {
                self.fill(&nearer.hull, &mut labels, PixelLabel::Unknown);
            }
        }
        self.nearer_unknown(&mut labels);
        labels
    }

    /// Returns on the object that the camera sees too, without those on the ground under it.
    pub(super) fn own_returns(&self) -> impl Iterator<Item = (&ProjectedReturn, DVec3)> {
        let ground = -self.size_m.z / 2.0 + GROUND_BAND_M;
        self.loaded.returns.iter().filter_map(move |r| {
            let owner = r.owner.filter(|o| o.track == self.outline.track)?;
            (!r.occluded && owner.cuboid_m.z > ground).then_some((r, owner.cuboid_m))
        })
    }

    /// Column by column from the highest to the lowest return: closes glass between roof and body, keeps the air above a bonnet.
    fn object_spans(&self) -> Vec<bool> {
        let (width, height) = (self.crop.width, self.crop.height);
        let reach = (self.loaded.camera.focal_px.x * RETURN_X_RAD)
            .ceil()
            .max(1.0) as usize;
        let mut spans: Vec<Option<(f64, f64)>> = vec![None; width];
        for (r, _) in self.own_returns() {
            let at = self.in_crop(r.pixel);
            if at.x < 0.0 || at.x >= width as f64 {
                continue;
            }
            let x = at.x as usize;
            for span in &mut spans[x.saturating_sub(reach)..(x + reach + 1).min(width)] {
                *span = Some(span.map_or((at.y, at.y), |(lo, hi)| (lo.min(at.y), hi.max(at.y))));
            }
        }
        close_spans(&mut spans);
        let mut object = vec![false; width * height];
        for (x, span) in spans.iter().enumerate() {
            let Some((lo, hi)) = span else { continue };
            let rows = lo.max(0.0) as usize..((hi + 1.0).max(0.0) as usize).min(height);
            for y in rows {
                object[y * width + x] = true;
            }
        }
        object
    }

    /// Where a return lies behind the cuboid and no object span is near, the ray passes the object by.
    fn farther_background(&self, labels: &mut [PixelLabel], object: &[bool]) {
        let near_object = super::raster::dilate(object, self.crop.width, 2);
        for r in &self.loaded.returns {
            let passes = self
                .cuboid_range(r)
                .is_some_and(|(_, exit_m)| r.proven_m() > exit_m + DEPTH_SLACK_M);
            if passes && !r.occluded {
                self.splat(r.pixel, 0.5, |i| {
                    if labels[i] == PixelLabel::Unknown && !near_object[i] {
                        labels[i] = PixelLabel::Background;
                    }
                });
            }
        }
    }

    /// Poles, trees and unlabelled traffic in front: what they hide is unknown. The ground in front is not in front.
    fn nearer_unknown(&self, labels: &mut [PixelLabel]) {
        let cuboid_from_world =
            (self.loaded.world_from_camera * self.outline.camera_from_cuboid).inverse();
        let ground = -self.size_m.z / 2.0 + GROUND_BAND_M;
        for r in &self.loaded.returns {
            let is_own = r.owner.is_some_and(|o| o.track == self.outline.track);
            let hides = self
                .cuboid_range(r)
                .is_some_and(|(entry_m, _)| r.range_m < entry_m - DEPTH_SLACK_M);
            if !is_own && hides && cuboid_from_world.point(r.world_m).z > ground {
                self.splat(r.pixel, 1.0, |i| labels[i] = PixelLabel::Unknown);
            }
        }
    }

    /// Where the ray through a return enters and leaves the grown cuboid, in metres from the camera.
    fn cuboid_range(&self, r: &ProjectedReturn) -> Option<(f64, f64)> {
        let cuboid_from_camera = self.outline.camera_from_cuboid.inverse();
        let origin = cuboid_from_camera.translation_m;
        let along = cuboid_from_camera.direction(self.loaded.camera.direction(r.pixel));
        let half = self.size_m / 2.0 + DVec3::splat(CUBOID_MARGIN_M);
        let (a, b) = ((-half - origin) / along, (half - origin) / along);
        let entry_m = a.min(b).max_element();
        let exit_m = a.max(b).min_element();
        (entry_m < exit_m && exit_m > 0.0).then_some((entry_m, exit_m))
    }

    /// Visits the crop's pixels that one return stands for, its extent scaled by `scale`.
    fn splat(&self, pixel: DVec2, scale: f64, mut visit: impl FnMut(usize)) {
        let focal_px = self.loaded.camera.focal_px;
        let half = focal_px * DVec2::new(RETURN_X_RAD, RETURN_Y_RAD) * scale;
        let at = self.in_crop(pixel);
        let end = DVec2::new(self.crop.width as f64, self.crop.height as f64);
        let lo = (at - half).floor().clamp(DVec2::ZERO, end).as_usizevec2();
        let hi = (at + half).ceil().clamp(DVec2::ZERO, end).as_usizevec2();
        for y in lo.y..hi.y {
            for x in lo.x..hi.x {
                visit(y * self.crop.width + x);
            }
        }
    }

    /// The strip under the object: contact shadow, and returns say nothing there.
    fn contact_below(&self, labels: &mut [PixelLabel]) {
        let width = self.crop.width;
        for x in 0..width {
            let mut left = 0;
            for y in 0..self.crop.height {
                let label = &mut labels[y * width + x];
                match *label {
                    PixelLabel::Foreground => left = CONTACT_PX,
                    PixelLabel::Background if left > 0 => {
                        *label = PixelLabel::Unknown;
                        left -= 1;
                    }
                    _ => left = left.saturating_sub(1),
                }
            }
        }
    }

    fn fill(&self, hull: &[DVec2], labels: &mut [PixelLabel], with: PixelLabel) {
        self.visit(hull, labels, |label| *label = with);
    }

    /// Visits the labels of the crop's pixels inside a hull of the whole image.
    fn visit(
        &self,
        hull: &[DVec2],
        labels: &mut [PixelLabel],
        mut each: impl FnMut(&mut PixelLabel),
    ) {
        let offset = DVec2::new(self.crop.x as f64, self.crop.y as f64);
        let moved: Vec<DVec2> = hull.iter().map(|&p| p - offset).collect();
        let size = (self.crop.width as u32, self.crop.height as u32);
        raster(&moved, size.0, size.1, |row, columns| {
            labels[row * self.crop.width..][columns]
                .iter_mut()
                .for_each(&mut each);
        });
    }

    pub(super) fn in_crop(&self, pixel: DVec2) -> DVec2 {
        pixel - DVec2::new(self.crop.x as f64, self.crop.y as f64)
    }

    fn image_width(&self) -> usize {
        self.loaded.camera.width as usize
    }
}

/// Fills notches of the upper and lower outline that are narrower than an eighth of the object: glass returns nothing.
fn close_spans(spans: &mut [Option<(f64, f64)>]) {
    let known = spans.iter().flatten().count();
    let reach = known / 16;
    let near = |x: usize| x.saturating_sub(reach)..(x + reach + 1).min(spans.len());
    let grown: Vec<Option<(f64, f64)>> = (0..spans.len())
        .map(|x| merge_spans(&spans[near(x)], f64::min, f64::max))
        .collect();
    let closed: Vec<Option<(f64, f64)>> = (0..spans.len())
        .map(|x| merge_spans(&grown[near(x)], f64::max, f64::min))
        .collect();
    for (span, closed) in spans.iter_mut().zip(closed) {
        *span = span.and(closed);
    }
}

fn merge_spans(
    spans: &[Option<(f64, f64)>],
    top: fn(f64, f64) -> f64,
    bottom: fn(f64, f64) -> f64,
) -> Option<(f64, f64)> {
    spans
        .iter()
        .flatten()
        .copied()
        .reduce(|a, b| (top(a.0, b.0), bottom(a.1, b.1)))
}

/// Object and background pixels that touch each other mix both colours: neither supervises.
fn rim_unknown(labels: &mut [PixelLabel], width: usize) {
    use PixelLabel::{Background, Foreground};
    let before = labels.to_vec();
    let mixes = |a, b| matches!((a, b), (Foreground, Background) | (Background, Foreground));
    for (i, label) in labels.iter_mut().enumerate() {
        let x = i % width;
        let touches = (x > 0 && mixes(before[i], before[i - 1]))
            || (x + 1 < width && mixes(before[i], before[i + 1]))
            || (i >= width && mixes(before[i], before[i - width]))
            || (i + width < before.len() && mixes(before[i], before[i + width]));
        if touches {
            *label = PixelLabel::Unknown;
        }
    }
}

/// The rectangle around the padded cuboid, within the image; `None` if nothing of it is inside.
pub(super) fn crop_around(camera: &Camera, outline: &Outline, size_m: DVec3) -> Option<Crop> {
    /// Room around the cuboid, so that rays past the object are seen too.
    const ROOM_M: f64 = 0.35;
    /// Room in pixels for far objects.
    const ROOM_PX: f64 = 3.0;
    let grown = size_m + DVec3::splat(2.0 * ROOM_M);
    let hull = cuboid_hull(camera, &outline.camera_from_cuboid, grown);
    let (lo, hi) = super::hull::bounds(&hull)?;
    let size = DVec2::new(f64::from(camera.width), f64::from(camera.height));
    let lo = (lo - ROOM_PX)
        .floor()
        .clamp(DVec2::ZERO, size)
        .as_usizevec2();
    let hi = (hi + ROOM_PX)
        .ceil()
        .clamp(DVec2::ZERO, size)
        .as_usizevec2();
    (lo.x < hi.x && lo.y < hi.y).then_some(Crop {
        x: lo.x,
        y: lo.y,
        width: hi.x - lo.x,
        height: hi.y - lo.y,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn narrow_notches_of_the_outline_are_closed_and_wide_ones_kept() {
        let mut spans = vec![Some((10.0, 90.0)); 160];
        spans[40..50].fill(Some((60.0, 90.0)));
        spans[100..140].fill(Some((60.0, 90.0)));
        close_spans(&mut spans);
        assert!(spans[..100].iter().all(|s| *s == Some((10.0, 90.0))));
        assert_eq!(spans[120], Some((60.0, 90.0)));
        let mut nothing = vec![None; 10];
        close_spans(&mut nothing);
        assert_eq!(nothing, vec![None; 10]);
    }

    #[test]
    fn only_pixels_on_the_outline_become_unknown() {
        use PixelLabel::{Background as B, Foreground as F, Unknown as U};
        let mut labels = vec![B, B, F, F, F, F, B, B];
        rim_unknown(&mut labels, 8);
        assert_eq!(labels, [B, U, U, F, F, U, U, B]);
    }
}
