//! Whether a track's matched masks agree from frame to frame.
//!
//! A mask is brought to the bounds of its cuboid's projection, so that it can be laid over those of the frames before and after. A mask
//! that agrees with neither is not the object's, or not whole.

use std::collections::BTreeMap;

use super::hull::bounds;
use super::mask_overlap::Overlaps;
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
}

/// A mask in the bounds of its cuboid's projection.
#[derive(Clone, Debug)]
pub(super) struct ScaledMask(Vec<Cell>);

impl ScaledMask {
    /// The mask `value` of `free`, an image of `size`, that was matched to the outline at `index`.
    pub(super) fn new(
        free: &[u16],
        size: (u32, u32),
        value: u16,
        overlaps: &Overlaps,
        (index, outline): (usize, &Outline),
    ) -> Self {
        let (lo, hi) = bounds(&outline.hull).expect("a matched outline has pixels");
        let step = (hi - lo) / SIDE as f64;
        let cell = |i: usize| {
            let at = glam::DVec2::new((i % SIDE) as f64 + 0.5, (i / SIDE) as f64 + 0.5);
            let pixel = lo + step * at;
            let end = glam::DVec2::new(f64::from(size.0), f64::from(size.1));
            if pixel.cmplt(glam::DVec2::ZERO).any() || pixel.cmpge(end).any() {
                return Cell::Unknown;
            }
            let pixel = pixel.y as usize * size.0 as usize + pixel.x as usize;
            match (overlaps.is_front(pixel, index), free[pixel] == value) {
                (false, _) => Cell::Unknown,
                (true, false) => Cell::Empty,
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
                let (a, b) = (a == Cell::Object, b == Cell::Object);
                known += 1;
                both += usize::from(a && b);
                either += usize::from(a || b);
            }
        }
        (known >= LEAST_CELLS).then(|| both as f64 / either.max(1) as f64)
    }
}

/// Follows the masks of every track through the frames of every camera, given in time order.
#[derive(Debug)]
pub(super) struct Consistency<'a> {
    least_iou: f64,
    /// The last mask of each camera and track.
    last: BTreeMap<(&'a str, usize), Followed>,
    inconsistent: Vec<(usize, usize)>,
}

#[derive(Debug)]
struct Followed {
    frame: usize,
    timestamp_ns: i64,
    mask: ScaledMask,
    /// Whether it was compared, and whether it agreed with a neighbour.
    compared: bool,
    agreed: bool,
}

impl<'a> Consistency<'a> {
    pub(super) fn new(least_iou: f64) -> Self {
        Self {
            least_iou,
            last: BTreeMap::new(),
            inconsistent: Vec::new(),
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
        };
        if let Some(mut last) = self.last.remove(&(camera_id, track)) {
            let near = timestamp_ns.abs_diff(last.timestamp_ns) <= NEIGHBOUR_NS;
            if let Some(iou) = last.mask.iou(&next.mask).filter(|_| near) {
                let agree = iou >= self.least_iou;
                for mask in [&mut last, &mut next] {
                    mask.compared = true;
                    mask.agreed |= agree;
                }
            }
            self.judge(track, &last);
        }
        self.last.insert((camera_id, track), next);
    }

    /// (frame, track) of every mask that was compared with its neighbours and agrees with none.
    pub(super) fn finish(mut self) -> Vec<(usize, usize)> {
        for ((_, track), last) in std::mem::take(&mut self.last) {
            self.judge(track, &last);
        }
        self.inconsistent
    }

    fn judge(&mut self, track: usize, mask: &Followed) {
        if mask.compared && !mask.agreed {
            self.inconsistent.push((mask.frame, track));
        }
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

    fn inconsistent(cells: &[usize], step_ns: i64, least_iou: f64) -> Vec<usize> {
        let mut consistency = Consistency::new(least_iou);
        for (frame, &cells) in cells.iter().enumerate() {
            let at = (frame, frame as i64 * step_ns);
            consistency.follow("front", 3, at, filled(cells));
        }
        let found = consistency.finish();
        assert!(found.iter().all(|(_, track)| *track == 3));
        found.into_iter().map(|(frame, _)| frame).collect()
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

    #[test]
    fn what_only_one_of_them_sees_is_not_compared() {
        let hidden = ScaledMask(vec![Cell::Unknown; SIDE * SIDE]);
        assert_eq!(filled(300).iou(&hidden), None);
        assert_eq!(filled(300).iou(&filled(150)), Some(0.5));
    }
}
