//! Which free mask shows which track, in one image.
//!
//! Masks come missed, false and merged. A pair is possible if mask and cuboid overlap enough and the mask shows nothing else;
//! among the possible pairs the assignment with the largest sum of overlaps is taken. What stays is refused with its reason.

use std::collections::{BTreeMap, BTreeSet};

use pathfinding::prelude::{Matrix, kuhn_munkres};
use serde::Serialize;

use super::mask_overlap::Overlaps;
use super::object_plan::{Outline, Rejection};

/// When a mask is taken for a track's.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct MaskMatching {
    /// Least intersection over union of a mask and its cuboid's visible projection. Cars fill about 0.75 of theirs.
    pub least_iou: f64,
    /// Least intersection over union with the same track's mask in a neighbouring frame, both scaled to their cuboids.
    pub least_follow_iou: f64,
    /// A mask that shows more than this share of the visible region of a cuboid behind its own shows that object too: nothing of an
    /// object reaches beyond its own hull but for loose annotations.
    pub most_of_farther: f64,
    /// The same for cuboids in front, whose hulls show what is behind in their corners: people fill half of theirs.
    pub most_of_nearer: f64,
    /// The share of a mask that may reach out of its cuboid's hull: annotations are loose.
    pub most_outside: f64,
    /// The share of the LiDAR returns in a mask that may be on other objects: one in fifty goes astray.
    pub most_returns_of_others: f64,
    /// The share of a mask that may be new against the same track's mask in a neighbouring frame, where another cuboid is behind.
    pub most_grown: f64,
}

impl Default for MaskMatching {
    fn default() -> Self {
        Self {
            least_iou: 0.5,
            least_follow_iou: 0.5,
            most_of_farther: 0.15,
            most_of_nearer: 0.6,
            most_outside: 0.2,
            most_returns_of_others: 0.02,
            // Two of the cells that a car fills.
            most_grown: 0.004,
        }
    }
}

/// Regions smaller than this say nothing.
const LEAST_REGION_PX: u32 = 12;

/// What became of a free mask.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum MaskOutcome {
    Matched,
    /// It shows more than one object.
    Merged,
    /// No cuboid is near it: a false detection, or an object that is not annotated.
    NoCuboid,
    /// It overlaps cuboids, none of them enough.
    LowOverlap,
    /// The cuboid that it fits is of another class.
    OtherClass,
    /// Another mask fits its cuboid better.
    Duplicate,
    /// It differs from the track's masks before and after it.
    Inconsistent,
}

impl MaskOutcome {
    /// Name in reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Matched => "matched",
            Self::Merged => "merged",
            Self::NoCuboid => "no_cuboid",
            Self::LowOverlap => "low_overlap",
            Self::OtherClass => "other_class",
            Self::Duplicate => "duplicate",
            Self::Inconsistent => "inconsistent",
        }
    }
}

/// The masks of one image.
#[derive(Clone, Debug, Default)]
pub(super) struct FrameMatch {
    /// Track of each matched mask, by the mask's value.
    pub track_of: BTreeMap<u16, usize>,
    /// Tracks that are in the image without a mask of their own, and why.
    pub unmasked: BTreeMap<usize, Rejection>,
    /// What became of each mask, by its value.
    pub outcomes: BTreeMap<u16, MaskOutcome>,
}

/// What is known of masks beyond their pixels.
pub(super) struct Evidence<C, R> {
    /// Whether the mask of a value may show a track, as far as its class goes.
    pub may_be: C,
    /// The share of the returns in a mask that are on other objects than the one at an outline, both by index.
    pub share_of_others: R,
}

/// Matches the masks of one image.
pub(super) fn match_frame<C, R>(
    overlaps: &Overlaps,
    outlines: &[Outline],
    matching: &MaskMatching,
    evidence: &Evidence<C, R>,
) -> FrameMatch
where
    C: Fn(u16, usize) -> bool,
    R: Fn(usize, usize) -> f64,
{
    let mut possible: BTreeMap<(usize, usize), f64> = BTreeMap::new();
    let mut merged = BTreeSet::new();
    let mut of_other_class = BTreeSet::new();
    for (mask, outline) in overlaps.pairs() {
        let iou = overlaps.iou(mask, outline);
        if iou < matching.least_iou || overlaps.visible_px[outline] < LEAST_REGION_PX {
            continue;
        }
        let of_others = (evidence.share_of_others)(mask, outline);
        if of_others > matching.most_returns_of_others
            || shows_more(overlaps, outlines, (mask, outline), matching)
        {
            merged.insert(mask);
        } else if !(evidence.may_be)(overlaps.masks[mask], outlines[outline].track) {
            of_other_class.insert(mask);
        } else {
            possible.insert((mask, outline), iou);
        }
    }
    let assigned = assign(&possible);
    let mut found = FrameMatch::default();
    for (mask, &value) in overlaps.masks.iter().enumerate() {
        let outcome = match assigned.get(&mask) {
            Some(&outline) => {
                found.track_of.insert(value, outlines[outline].track);
                MaskOutcome::Matched
            }
            None if possible.keys().any(|(m, _)| *m == mask) => MaskOutcome::Duplicate,
            None if merged.contains(&mask) => MaskOutcome::Merged,
            None if of_other_class.contains(&mask) => MaskOutcome::OtherClass,
            None => refusal(overlaps, mask, matching),
        };
        found.outcomes.insert(value, outcome);
    }
    found.unmasked = unmasked(overlaps, outlines, &found, matching);
    found
}

/// Whether a mask that fits a cuboid also shows another one, or much that is in no cuboid of its own.
fn shows_more(
    overlaps: &Overlaps,
    outlines: &[Outline],
    (mask, own): (usize, usize),
    matching: &MaskMatching,
) -> bool {
    let inside = overlaps.shared(mask, own).hull_px;
    let outside = overlaps.mask_px[mask] - inside;
    if f64::from(outside) > matching.most_outside * f64::from(overlaps.mask_px[mask]) {
        return true;
    }
    (0..outlines.len()).filter(|&o| o != own).any(|other| {
        let limit = if outlines[other].distance_m > outlines[own].distance_m {
            matching.most_of_farther
        } else {
            matching.most_of_nearer
        };
        shown_share(overlaps, mask, other) > limit
    })
}

/// The share of a cuboid's visible region that a mask covers; 0 if the region is too small to tell.
fn shown_share(overlaps: &Overlaps, mask: usize, outline: usize) -> f64 {
    let region_px = overlaps.visible_px[outline];
    if region_px < LEAST_REGION_PX {
        return 0.0;
    }
    f64::from(overlaps.shared(mask, outline).visible_px) / f64::from(region_px)
}

/// The assignment with the largest sum of overlaps: outline of each mask that gets one.
fn assign(possible: &BTreeMap<(usize, usize), f64>) -> BTreeMap<usize, usize> {
    let masks: BTreeSet<usize> = possible.keys().map(|(mask, _)| *mask).collect();
    let outlines: BTreeSet<usize> = possible.keys().map(|(_, outline)| *outline).collect();
    let (masks, outlines): (Vec<_>, Vec<_>) =
        (masks.into_iter().collect(), outlines.into_iter().collect());
    if masks.is_empty() {
        return BTreeMap::new();
    }
    // Whole millionths, since the algorithm needs an order; 0 is no pair.
    let weight = |mask: usize, outline: usize| {
        let iou = possible.get(&(masks[mask], outlines[outline]));
        iou.map_or(0, |iou| (iou * 1e6) as i64)
    };
    // The library wants no more rows than columns.
    let masks_are_rows = masks.len() <= outlines.len();
    let pairs: Vec<(usize, usize)> = if masks_are_rows {
        let weights = Matrix::from_fn(masks.len(), outlines.len(), |(m, o)| weight(m, o));
        kuhn_munkres(&weights).1.into_iter().enumerate().collect()
    } else {
        let weights = Matrix::from_fn(outlines.len(), masks.len(), |(o, m)| weight(m, o));
        let columns = kuhn_munkres(&weights).1.into_iter().enumerate();
        columns.map(|(outline, mask)| (mask, outline)).collect()
    };
    pairs
        .into_iter()
        .filter(|&(mask, outline)| weight(mask, outline) > 0)
        .map(|(mask, outline)| (masks[mask], outlines[outline]))
        .collect()
}

/// Why a mask has no cuboid to choose from.
fn refusal(overlaps: &Overlaps, mask: usize, matching: &MaskMatching) -> MaskOutcome {
    let shown = (0..overlaps.visible_px.len())
        .filter(|&outline| shown_share(overlaps, mask, outline) > matching.most_of_farther)
        .count();
    match shown {
        0 => MaskOutcome::NoCuboid,
        1 => MaskOutcome::LowOverlap,
        _ => MaskOutcome::Merged,
    }
}

/// The tracks in the image that got no mask.
fn unmasked(
    overlaps: &Overlaps,
    outlines: &[Outline],
    found: &FrameMatch,
    matching: &MaskMatching,
) -> BTreeMap<usize, Rejection> {
    let matched: BTreeSet<usize> = found.track_of.values().copied().collect();
    let is_merged = |outline: usize| {
        overlaps.masks.iter().enumerate().any(|(mask, value)| {
            found.outcomes[value] == MaskOutcome::Merged
                && shown_share(overlaps, mask, outline) > matching.most_of_farther
        })
    };
    outlines
        .iter()
        .enumerate()
        .filter(|(index, outline)| {
            overlaps.visible_px[*index] > 0 && !matched.contains(&outline.track)
        })
        .map(|(index, outline)| {
            let reason = if is_merged(index) {
                Rejection::MergedMask
            } else {
                Rejection::NoMask
            };
            (outline.track, reason)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use backlot_engine::camera::Rigid;
    use glam::DVec2;

    use super::*;

    const SIZE: (u32, u32) = (60, 40);
    /// Columns and rows.
    type Rectangle = (std::ops::Range<usize>, std::ops::Range<usize>);

    fn outline(track: usize, (columns, rows): Rectangle, distance_m: f64) -> Outline {
        let corner = |x: usize, y: usize| DVec2::new(x as f64, y as f64);
        Outline {
            track,
            hull: vec![
                corner(columns.start, rows.start),
                corner(columns.end, rows.start),
                corner(columns.end, rows.end),
                corner(columns.start, rows.end),
            ],
            distance_m,
            camera_from_cuboid: Rigid::IDENTITY,
        }
    }

    fn mask(parts: &[(u16, Rectangle)]) -> Vec<u16> {
        let mut mask = vec![0; (SIZE.0 * SIZE.1) as usize];
        for (value, (columns, rows)) in parts {
            for row in rows.clone() {
                mask[row * SIZE.0 as usize..][columns.clone()].fill(*value);
            }
        }
        mask
    }

    /// A near car, one half behind it, and one apart.
    fn street() -> Vec<Outline> {
        vec![
            outline(4, (5..25, 10..25), 10.0),
            outline(5, (20..40, 8..22), 15.0),
            outline(6, (45..58, 10..20), 12.0),
        ]
    }

    /// Without returns.
    fn evidence<C: Fn(u16, usize) -> bool>(may_be: C) -> Evidence<C, impl Fn(usize, usize) -> f64> {
        Evidence {
            may_be,
            share_of_others: |_, _| 0.0,
        }
    }

    fn matched(parts: &[(u16, Rectangle)], matching: &MaskMatching) -> FrameMatch {
        let overlaps = Overlaps::of(&mask(parts), SIZE, &street());
        match_frame(&overlaps, &street(), matching, &evidence(|_, _| true))
    }

    #[test]
    fn intact_masks_find_their_tracks_and_false_ones_find_none() {
        let found = matched(
            &[
                (900, (6..24, 11..25)),
                (17, (24..39, 9..22)),
                (3, (0..9, 30..38)),
            ],
            &MaskMatching::default(),
        );
        assert_eq!(found.track_of, BTreeMap::from([(900, 4), (17, 5)]));
        assert_eq!(found.outcomes[&3], MaskOutcome::NoCuboid);
        assert_eq!(
            found.unmasked,
            BTreeMap::from([(6, Rejection::NoMask)]),
            "its mask was missed"
        );
    }

    #[test]
    fn a_mask_over_two_cuboids_is_refused_however_small_the_second_is() {
        // The second object shows 5, then 20 columns beside the first.
        for end in [30, 40] {
            let both = [(8, (6..24, 11..25)), (8, (24..end, 9..22))];
            let found = matched(&both, &MaskMatching::default());
            assert!(found.track_of.is_empty(), "{found:?}");
            assert_eq!(found.outcomes[&8], MaskOutcome::Merged);
            assert_eq!(found.unmasked[&4], Rejection::MergedMask);
            assert_eq!(found.unmasked[&5], Rejection::MergedMask);
            assert_eq!(found.unmasked[&6], Rejection::NoMask);
        }
        // Without the check the first of them would be taken for the near car.
        let careless = MaskMatching {
            most_of_farther: 1.0,
            most_of_nearer: 1.0,
            most_outside: 1.0,
            ..MaskMatching::default()
        };
        let both = [(8, (6..24, 11..25)), (8, (24..30, 9..22))];
        assert_eq!(matched(&both, &careless).track_of[&8], 4);
    }

    #[test]
    fn a_mask_behind_a_nearer_cuboid_is_not_punished_for_its_corners() {
        // The hidden car shows in a corner of the nearer one's hull.
        let found = matched(&[(2, (22..39, 9..22))], &MaskMatching::default());
        assert_eq!(found.track_of, BTreeMap::from([(2, 5)]));
    }

    #[test]
    fn a_mask_with_returns_of_another_object_is_merged() {
        let overlaps = Overlaps::of(&mask(&[(2, (46..57, 11..20))]), SIZE, &street());
        let matched = |share: f64| {
            let evidence = Evidence {
                may_be: |_: u16, _: usize| true,
                share_of_others: move |mask, outline| f64::from((mask, outline) == (0, 2)) * share,
            };
            match_frame(&overlaps, &street(), &MaskMatching::default(), &evidence)
        };
        assert_eq!(matched(0.01).track_of, BTreeMap::from([(2, 6)]));
        assert!(matched(0.1).track_of.is_empty());
        assert_eq!(matched(0.1).outcomes[&2], MaskOutcome::Merged);
        assert_eq!(matched(0.1).unmasked[&6], Rejection::MergedMask);
    }

    #[test]
    fn a_mask_of_another_class_is_no_tracks() {
        let overlaps = Overlaps::of(&mask(&[(2, (46..57, 11..20))]), SIZE, &street());
        let matching = MaskMatching::default();
        let any = evidence(|_, _| true);
        let found = match_frame(&overlaps, &street(), &matching, &any);
        assert_eq!(found.track_of, BTreeMap::from([(2, 6)]));
        let not_that = evidence(|mask, track| (mask, track) != (2, 6));
        let found = match_frame(&overlaps, &street(), &matching, &not_that);
        assert!(found.track_of.is_empty());
        assert_eq!(found.outcomes[&2], MaskOutcome::OtherClass);
        assert_eq!(found.unmasked[&6], Rejection::NoMask);
    }

    #[test]
    fn a_fragment_is_refused_for_its_low_overlap() {
        let found = matched(&[(2, (46..50, 11..18))], &MaskMatching::default());
        assert_eq!(found.outcomes[&2], MaskOutcome::LowOverlap);
        assert_eq!(found.unmasked[&6], Rejection::NoMask);
    }

    #[test]
    fn the_assignment_is_the_best_one_and_not_the_first() {
        let possible = BTreeMap::from([((0, 0), 0.6), ((0, 1), 0.55), ((1, 0), 0.5)]);
        // Taking the largest pair first leaves mask 1 without a cuboid.
        assert_eq!(assign(&possible), BTreeMap::from([(0, 1), (1, 0)]));
        let crowded = BTreeMap::from([((0, 0), 0.6), ((1, 0), 0.7), ((2, 0), 0.65)]);
        assert_eq!(assign(&crowded), BTreeMap::from([(1, 0)]));
        assert!(assign(&BTreeMap::new()).is_empty());
    }
}
