//! The pixels that free masks and projected cuboids share in one image.

use std::collections::HashMap;

use super::free_masks::instances;
use super::hull::raster;
use super::object_plan::Outline;
use crate::domain::drive_log::{MASK_NONE, MASK_UNKNOWN};

/// No cuboid at this pixel.
const NOTHING: u32 = u32::MAX;

/// Pixel counts of every mask, every cuboid and every pair of them that meets.
///
/// A cuboid's *visible region* is its projected hull without the hulls of nearer cuboids. Under a nearer hull a mask may or may not
/// go on, since objects do not fill their hulls: there a pixel speaks neither for nor against a pair.
#[derive(Debug)]
pub(super) struct Overlaps {
    /// The masks' values, ascending.
    pub masks: Vec<u16>,
    pub mask_px: Vec<u32>,
    /// Of each outline.
    pub visible_px: Vec<u32>,
    pairs: HashMap<(usize, usize), Shared>,
    /// Nearest cuboid of each pixel, by index into the outlines.
    front: Vec<u32>,
}

/// Pixels of a mask in a cuboid's visible region and in its whole hull.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Shared {
    pub visible_px: u32,
    pub hull_px: u32,
}

impl Overlaps {
    /// `free` is row-major of `size`, (width, height).
    pub(super) fn of(free: &[u16], size: (u32, u32), outlines: &[Outline]) -> Self {
        let masks = instances(free);
        let front = front(size, outlines);
        let mut overlaps = Self {
            mask_px: vec![0; masks.len()],
            visible_px: vec![0; outlines.len()],
            pairs: HashMap::new(),
            masks,
            front,
        };
        overlaps.count_visible(free);
        overlaps.count_hulls(free, size, outlines);
        overlaps
    }

    pub(super) fn shared(&self, mask: usize, outline: usize) -> Shared {
        let found = self.pairs.get(&(mask, outline));
        found.copied().unwrap_or_default()
    }

    /// Intersection over union of a mask and a cuboid's visible region; what lies under nearer hulls counts in neither.
    pub(super) fn iou(&self, mask: usize, outline: usize) -> f64 {
        let shared = self.shared(mask, outline);
        let outside = self.mask_px[mask] - shared.hull_px;
        let union = self.visible_px[outline] + outside;
        f64::from(shared.visible_px) / f64::from(union.max(1))
    }

    /// The pairs that share a pixel, in no order.
    pub(super) fn pairs(&self) -> impl Iterator<Item = (usize, usize)> + '_ {
        self.pairs.keys().copied()
    }

    /// Whether the outline is the nearest one at a pixel.
    pub(super) fn is_front(&self, pixel: usize, outline: usize) -> bool {
        self.front[pixel] == outline as u32
    }

    fn count_visible(&mut self, free: &[u16]) {
        let mut at = 0;
        while at < free.len() {
            let (value, outline) = (free[at], self.front[at]);
            let same = |i: &usize| free[*i] == value && self.front[*i] == outline;
            let end = (at..free.len()).take_while(same).count() + at;
            let count = (end - at) as u32;
            if outline != NOTHING {
                self.visible_px[outline as usize] += count;
            }
            if let Some(mask) = self.index_of(value) {
                self.mask_px[mask] += count;
                if outline != NOTHING {
                    let pair = self.pairs.entry((mask, outline as usize)).or_default();
                    pair.visible_px += count;
                }
            }
            at = end;
        }
    }

    fn count_hulls(&mut self, free: &[u16], size: (u32, u32), outlines: &[Outline]) {
        let width = size.0 as usize;
        for (index, outline) in outlines.iter().enumerate() {
            raster(&outline.hull, size.0, size.1, |row, columns| {
                for run in free[row * width..][columns].chunk_by(|a, b| a == b) {
                    if let Some(mask) = self.index_of(run[0]) {
                        let pair = self.pairs.entry((mask, index)).or_default();
                        pair.hull_px += run.len() as u32;
                    }
                }
            });
        }
    }

    fn index_of(&self, value: u16) -> Option<usize> {
        if value == MASK_NONE || value == MASK_UNKNOWN {
            return None;
        }
        self.masks.binary_search(&value).ok()
    }
}

/// The nearest cuboid's index at each pixel.
fn front(size: (u32, u32), outlines: &[Outline]) -> Vec<u32> {
    let width = size.0 as usize;
    let mut front = vec![NOTHING; width * size.1 as usize];
    let mut farthest_first: Vec<usize> = (0..outlines.len()).collect();
    farthest_first.sort_by(|&a, &b| outlines[b].distance_m.total_cmp(&outlines[a].distance_m));
    for index in farthest_first {
        raster(&outlines[index].hull, size.0, size.1, |row, columns| {
            front[row * width..][columns].fill(index as u32);
        });
    }
    front
}
