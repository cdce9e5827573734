//! Whether a track's matched masks agree from frame to frame.
//!
//! A mask is brought to the bounds of its cuboid's projection, so that it can be laid over those of the frames before and after. A mask
//! that agrees with neither is not the object's, or not whole. One that has grown against either where another cuboid is behind
//! shows that object too: its own has the same shape in both.

use std::collections::BTreeMap;

use glam::DVec2;

use super::hull::{bounds, contains};
use super::mask_match::MaskMatching;
use super::mask_overlap::Overlaps;
use super::mask_returns::MaskedImage;
use super::object_plan::Outline;

/// Cells along each side of a scaled mask.
const SIDE: usize = 24;
/// Cells that both masks must know before they are compared.
const LEAST_CELLS: usize = 48;
/// Frames farther apart show too different a side.
const NEIGHBOUR_NS: u64 = 1_000_000_000;

/// What a mask says about a cell of its cuboid's bounds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Cell {
    /// Outside the hull or the image, or under a nearer cuboid.
    Unknown,
    Empty,
    Object,
    /// The mask, where another cuboid is behind.
    ObjectBefore,
}

impl Cell {
    fn is_object(self) -> bool {
        matches!(self, Self::Object | Self::ObjectBefore)
    }
}

/// A mask in the bounds of its cuboid's projection.
#[derive(Clone, Debug)]
pub(super) struct ScaledMask(Vec<Cell>);

impl ScaledMask {
    /// The mask `value`, that was matched to the outline at index `own`.
    pub(super) fn new(
        image: &MaskedImage<'_>,
        value: u16,
        overlaps: &Overlaps,
        own: usize,
    ) -> Self {
        let outline = &image.outlines[own];
        let (lo, hi) = bounds(&outline.hull).expect("a matched outline has pixels");
        let step = (hi - lo) / SIDE as f64;
        let is_behind = |other: &&Outline| other.distance_m > outline.distance_m;
        let behind: Vec<&Outline> = image.outlines.iter().filter(is_behind).collect();
        let cell = |i: usize| {
            let at = DVec2::new((i % SIDE) as f64 + 0.5, (i / SIDE) as f64 + 0.5);
            let position = lo + step * at;
            let Some(pixel) = image.index_of(position) else {
                return Cell::Unknown;
            };
            match (overlaps.is_front(pixel, own), image.free[pixel] == value) {
                (false, _) => Cell::Unknown,
                (true, false) => Cell::Empty,
                (true, true) if behind.iter().any(|o| contains(&o.hull, position)) => {
                    Cell::ObjectBefore
                }
                (true, true) => Cell::Object,
            }
        };
        Self((0..SIDE * SIDE).map(cell).collect())
    }

    /// Intersection over union where both know; `None` if that is too little.
    fn iou(&self, other: &Self) -> Option<f64> {
        let (mut known, mut both, mut either) = (0, 0, 0);
        for (&a, &b) in self.0.iter().zip(&other.0) {
            if a != Cell::Unknown && b != Cell::Unknown {
                let (a, b) = (a.is_object(), b.is_object());
                known += 1;
                both += usize::from(a && b);
                either += usize::from(a || b);
            }
        }
        (known >= LEAST_CELLS).then(|| both as f64 / either.max(1) as f64)
    }

    /// The share of this mask that lies before another cuboid, where the other mask and all around it is empty.
    fn grown_over(&self, other: &Self) -> f64 {
        let object = self.0.iter().filter(|cell| cell.is_object()).count();
        let grown = (0..self.0.len())
            .filter(|&i| self.0[i] == Cell::ObjectBefore && other.is_empty_around(i))
            .count();
        grown as f64 / object.max(1) as f64
    }

    /// Edges move by a cell from frame to frame.
    fn is_empty_around(&self, i: usize) -> bool {
        let (x, y) = (i % SIDE, i / SIDE);
        let near = |at: usize| at.saturating_sub(1)..=(at + 1).min(SIDE - 1);
        near(y).all(|y| near(x).all(|x| self.0[y * SIDE + x] == Cell::Empty))
    }
}

/// Why a mask is not believed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Doubt {
    /// It was compared with its neighbours and agrees with none.
    Inconsistent,
    /// It has grown against one of them over a cuboid behind.
    Grown,
}

/// A mask that is not believed, by its frame and track.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Doubted {
    pub frame: usize,
    pub track: usize,
    pub doubt: Doubt,
}

/// Follows the masks of every track through the frames of every camera, given in time order.
#[derive(Debug)]
pub(super) struct Consistency<'a> {
    least_iou: f64,
    most_grown: f64,
    /// The last mask of each camera and track.
    last: BTreeMap<(&'a str, usize), Followed>,
    doubted: Vec<Doubted>,
}

#[derive(Debug)]
struct Followed {
    frame: usize,
    timestamp_ns: i64,
    mask: ScaledMask,
    /// Whether it was compared, and whether it agreed with a neighbour.
    compared: bool,
    agreed: bool,
    grown: bool,
}

impl<'a> Consistency<'a> {
    pub(super) fn new(matching: &MaskMatching) -> Self {
        Self {
            least_iou: matching.least_follow_iou,
            most_grown: matching.most_grown,
            last: BTreeMap::new(),
            doubted: Vec::new(),
        }
    }

    /// The next mask of a track in a camera.
    pub(super) fn follow(
        &mut self,
        camera_id: &'a str,
        track: usize,
        (frame, timestamp_ns): (usize, i64),
        mask: ScaledMask,
    ) {
        let mut next = Followed {
            frame,
            timestamp_ns,
            mask,
            compared: false,
            agreed: false,
            grown: false,
        };
        if let Some(mut last) = self.last.remove(&(camera_id, track)) {
            if timestamp_ns.abs_diff(last.timestamp_ns) <= NEIGHBOUR_NS {
                self.compare(&mut last, &mut next);
            }
            self.judge(track, &last);
        }
        self.last.insert((camera_id, track), next);
    }

    fn compare(&self, last: &mut Followed, next: &mut Followed) {
        let Some(iou) = last.mask.iou(&next.mask) else {
            return;
        };
        last.grown |= last.mask.grown_over(&next.mask) > self.most_grown;
        next.grown |= next.mask.grown_over(&last.mask) > self.most_grown;
        let agree = iou >= self.least_iou;
        for mask in [last, next] {
            mask.compared = true;
            mask.agreed |= agree;
        }
    }

    /// Every mask that is not to be believed.
    pub(super) fn finish(mut self) -> Vec<Doubted> {
        for ((_, track), last) in std::mem::take(&mut self.last) {
            self.judge(track, &last);
        }
        self.doubted
    }

    fn judge(&mut self, track: usize, mask: &Followed) {
        let doubt = match mask {
            m if m.compared && !m.agreed => Doubt::Inconsistent,
            m if m.grown => Doubt::Grown,
            _ => return,
        };
        self.doubted.push(Doubted {
            frame: mask.frame,
            track,
            doubt,
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The object fills the first `cells` cells; the last quarter is not seen.
    fn filled(cells: usize) -> ScaledMask {
        let cell = |i: usize| match i {
            _ if i >= SIDE * SIDE * 3 / 4 => Cell::Unknown,
            _ if i < cells => Cell::Object,
            _ => Cell::Empty,
        };
        ScaledMask((0..SIDE * SIDE).map(cell).collect())
    }

    fn inconsistent(cells: &[usize], step_ns: i64, least_follow_iou: f64) -> Vec<usize> {
        let mut consistency = Consistency::new(&MaskMatching {
            least_follow_iou,
            ..MaskMatching::default()
        });
        for (frame, &cells) in cells.iter().enumerate() {
            let at = (frame, frame as i64 * step_ns);
            consistency.follow("front", 3, at, filled(cells));
        }
        let found = consistency.finish();
        assert!(
            found
                .iter()
                .all(|d| d.track == 3 && d.doubt == Doubt::Inconsistent)
        );
        found.into_iter().map(|d| d.frame).collect()
    }

    #[test]
    fn a_mask_that_agrees_with_no_neighbour_is_found() {
        let drive = [300, 310, 90, 305, 300, 80];
        assert_eq!(inconsistent(&drive, 100_000_000, 0.5), [2, 5]);
        // A demand that nothing fails finds nothing.
        assert!(inconsistent(&drive, 100_000_000, 0.0).is_empty());
    }

    #[test]
    fn masks_that_change_slowly_far_apart_or_alone_stay() {
        assert!(inconsistent(&[300, 270, 240, 200, 160], 100_000_000, 0.5).is_empty());
        assert!(inconsistent(&[300, 90, 300], 2_000_000_000, 0.5).is_empty());
        assert!(inconsistent(&[300], 1, 0.5).is_empty());
    }

    /// A mask of rows 12 to 23, with more of rows 4 to 9 on the left, where a cuboid is behind.
    fn with_more(columns: usize, before: bool) -> ScaledMask {
        let cell = |i: usize| match (i % SIDE, i / SIDE) {
            (_, 12..) => Cell::Object,
            (x, 4..10) if x < columns && before => Cell::ObjectBefore,
            (x, 4..10) if x < columns => Cell::Object,
            _ => Cell::Empty,
        };
        ScaledMask((0..SIDE * SIDE).map(cell).collect())
    }

    #[test]
    fn a_mask_that_has_grown_over_a_cuboid_behind_is_found() {
        let doubts = |masks: &[ScaledMask]| -> Vec<(usize, Doubt)> {
            let mut consistency = Consistency::new(&MaskMatching::default());
            for (frame, mask) in masks.iter().enumerate() {
                consistency.follow("front", 3, (frame, frame as i64), mask.clone());
            }
            let found = consistency.finish().into_iter();
            found.map(|d| (d.frame, d.doubt)).collect()
        };
        let own = || with_more(0, true);
        let merged = || with_more(4, true);
        assert_eq!(doubts(&[own(), merged(), own()]), [(1, Doubt::Grown)]);
        // Merged twice running, each differs from the one on its other side.
        let twice = [own(), merged(), merged(), own()];
        assert_eq!(doubts(&twice), [(1, Doubt::Grown), (2, Doubt::Grown)]);
        // What is before nothing is a door, and an edge may move by a cell.
        assert!(doubts(&[own(), with_more(4, false), own()]).is_empty());
        assert!(doubts(&[merged(), with_more(5, true), merged()]).is_empty());
    }

    #[test]
    fn what_only_one_of_them_sees_is_not_compared() {
        let hidden = ScaledMask(vec![Cell::Unknown; SIDE * SIDE]);
        assert_eq!(filled(300).iou(&hidden), None);
        assert_eq!(filled(300).iou(&filled(150)), Some(0.5));
    }
}
