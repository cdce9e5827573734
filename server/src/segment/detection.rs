//! Boxes of a model: which are kept, and how a mask fills one.

use std::collections::BTreeMap;

use glam::DVec2;

use super::instance::{Instance, InstanceMask, RoadUser};
use super::letterbox::Letterbox;

/// More than this many road users are in no image; the rest are the model's least sure ones.
pub(super) const MOST_INSTANCES: usize = 300;

/// How outputs become instances, whatever their layout.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Decoding {
    /// Road user of each class of the model; others are left out.
    pub classes: BTreeMap<u32, RoadUser>,
    pub least_score: f32,
    /// Boxes of one road user that overlap a surer one by more are taken for the same.
    pub most_iou: f64,
}

/// A box that a model put out.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Detection {
    pub class: RoadUser,
    pub score: f32,
    /// Corners in the model's input, pixels.
    pub least: DVec2,
    pub most: DVec2,
    /// Where the model's outputs say more about it.
    pub index: usize,
}

impl Detection {
    fn area(&self) -> f64 {
        let size = (self.most - self.least).max(DVec2::ZERO);
        size.x * size.y
    }

    /// Intersection over union of the boxes; 0 if both are empty.
    fn iou(&self, other: &Self) -> f64 {
        let shared = (self.most.min(other.most) - self.least.max(other.least)).max(DVec2::ZERO);
        let shared = shared.x * shared.y;
        let union = self.area() + other.area() - shared;
        if union > 0.0 { shared / union } else { 0.0 }
    }

    /// The instance whose pixels are those within the box for whose centres `is_inside` says so, in the input's pixels. `None` if
    /// it has no pixel.
    pub(super) fn instance(
        &self,
        letterbox: &Letterbox,
        is_inside: impl Fn(DVec2) -> bool,
    ) -> Option<Instance> {
        let (width, height) = letterbox.image_size();
        let least = letterbox.image_from_input(self.least);
        let most = letterbox.image_from_input(self.most);
        let columns = centres(least.x, most.x, width);
        let rows = centres(least.y, most.y, height);
        let mut pixels = Vec::with_capacity(columns.len() * rows.len());
        for y in rows.clone() {
            for x in columns.clone() {
                let centre = DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5);
                pixels.push(is_inside(letterbox.input_from_image(centre)));
            }
        }
        pixels.contains(&true).then(|| Instance {
            class: self.class,
            score: self.score,
            mask: InstanceMask {
                x: columns.start,
                y: rows.start,
                width: columns.len() as u32,
                height: rows.len() as u32,
                pixels,
            },
        })
    }
}

/// The pixels whose centres lie in an interval, within an image of this length.
fn centres(least: f64, most: f64, length: u32) -> std::ops::Range<u32> {
    let pixel = |edge: f64| (edge - 0.5).ceil().clamp(0.0, f64::from(length)) as u32;
    let start = pixel(least);
    start..pixel(most).max(start)
}

/// A model's outputs, their shapes and numbers checked.
pub(super) trait Detector {
    /// Boxes of road users that the model is sure enough of.
    fn detections(&self, decoding: &Decoding) -> Vec<Detection>;

    /// A box with its mask; `None` if it has no pixel in the image.
    fn instance(&self, found: &Detection, letterbox: &Letterbox) -> Option<Instance>;

    /// Instances in the image that `letterbox` put into the model's input, best first.
    fn instances(&self, letterbox: &Letterbox, decoding: &Decoding) -> Vec<Instance> {
        let kept = suppress(self.detections(decoding), decoding.most_iou);
        let masked = |found: &Detection| self.instance(found, letterbox);
        kept.iter().filter_map(masked).collect()
    }
}

/// Greedy non-maximum suppression: the surest boxes that overlap no surer one of their class by more than `most_iou`, best first, at
/// most [`MOST_INSTANCES`]. Equal scores go by their index, so that the outcome does not depend on the order of `detections`.
pub(super) fn suppress(mut detections: Vec<Detection>, most_iou: f64) -> Vec<Detection> {
    let surest_first =
        |a: &Detection, b: &Detection| b.score.total_cmp(&a.score).then(a.index.cmp(&b.index));
    detections.sort_by(surest_first);
    let mut kept: Vec<Detection> = Vec::new();
    for found in detections {
        if kept.len() == MOST_INSTANCES {
            break;
        }
        let repeats = |k: &Detection| k.class == found.class && k.iou(&found) > most_iou;
        if !kept.iter().any(repeats) {
            kept.push(found);
        }
    }
    kept
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Of a model with the classes person, tree and car.
    pub(in crate::segment) fn decoding() -> Decoding {
        Decoding {
            classes: BTreeMap::from([(0, RoadUser::Pedestrian), (2, RoadUser::Vehicle)]),
            least_score: 0.4,
            most_iou: 0.6,
        }
    }

    fn detections() -> impl Strategy<Value = Vec<Detection>> {
        let one = (
            0..3_usize,
            1..12_u32,
            0..20_u32,
            0..20_u32,
            1..12_u32,
            1..12_u32,
        );
        prop::collection::vec(one, 0..24).prop_map(|all| {
            let detection =
                |(index, (class, score, x, y, w, h)): (usize, (_, u32, u32, u32, u32, u32))| {
                    let least = DVec2::new(f64::from(x), f64::from(y));
                    Detection {
                        class: RoadUser::ALL[class],
                        score: score as f32 / 12.0,
                        least,
                        most: least + DVec2::new(f64::from(w), f64::from(h)),
                        index,
                    }
                };
            all.into_iter().enumerate().map(detection).collect()
        })
    }

    /// Overlap by counting the whole pixels of whole-numbered boxes.
    fn counted_iou(a: &Detection, b: &Detection) -> f64 {
        let holds = |d: &Detection, x: f64, y: f64| {
            d.least.x <= x && x < d.most.x && d.least.y <= y && y < d.most.y
        };
        let (mut both, mut either) = (0.0, 0.0);
        for x in 0..40 {
            for y in 0..40 {
                let (x, y) = (f64::from(x), f64::from(y));
                both += f64::from(holds(a, x, y) && holds(b, x, y));
                either += f64::from(holds(a, x, y) || holds(b, x, y));
            }
        }
        both / either
    }

    /// Whether a choice is the greedy one: a detection is kept if and only if no kept one that goes before it repeats it.
    fn is_greedy(all: &[Detection], kept: &[Detection], most_iou: f64) -> bool {
        let before = |a: &Detection, b: &Detection| {
            a.score > b.score || (a.score == b.score && a.index < b.index)
        };
        all.iter().all(|d| {
            let mut surer = kept.iter().filter(|k| before(k, d) && k.class == d.class);
            let repeated = surer.any(|k| counted_iou(k, d) > most_iou);
            kept.contains(d) != repeated
        })
    }

    proptest! {
        #[test]
        fn what_is_kept_is_what_brute_force_keeps(all in detections(), tenths in 1..9_u32) {
            let most_iou = f64::from(tenths) / 10.0 + 0.003;
            let kept = suppress(all.clone(), most_iou);
            prop_assert!(is_greedy(&all, &kept, most_iou));
            let mut backwards = all.clone();
            backwards.reverse();
            prop_assert_eq!(&suppress(backwards, most_iou), &kept);
            // Broken on purpose: the least sure is left out, or everything is kept.
            if kept.len() > 1 {
                prop_assert!(!is_greedy(&all, &kept[..kept.len() - 1], most_iou));
            }
            if kept.len() < all.len() {
                prop_assert!(!is_greedy(&all, &all, most_iou));
            }
        }
    }

    #[test]
    fn a_crowd_is_cut_at_the_limit() {
        let one = |index: usize| Detection {
            class: RoadUser::Pedestrian,
            score: 1.0 - index as f32 * 1e-4,
            least: DVec2::new(index as f64 * 2.0, 0.0),
            most: DVec2::new(index as f64 * 2.0 + 1.0, 5.0),
            index,
        };
        let kept = suppress((0..2 * MOST_INSTANCES).map(one).collect(), 0.5);
        assert_eq!(kept.len(), MOST_INSTANCES);
        assert_eq!(kept.last().unwrap().index, MOST_INSTANCES - 1);
    }

    #[test]
    fn a_box_takes_the_pixels_whose_centres_it_holds() {
        let letterbox = Letterbox::new((20, 10), (40, 40));
        // Twice as large, ten rows down.
        let found = Detection {
            class: RoadUser::Vehicle,
            score: 0.5,
            least: DVec2::new(5.0, 12.0),
            most: DVec2::new(11.0, 17.1),
            index: 0,
        };
        let instance = found.instance(&letterbox, |_| true).unwrap();
        let pixels: Vec<_> = instance.mask.coordinates().collect();
        assert_eq!(
            pixels,
            [
                (2, 1),
                (3, 1),
                (4, 1),
                (2, 2),
                (3, 2),
                (4, 2),
                (2, 3),
                (3, 3),
                (4, 3)
            ]
        );
        let half = found.instance(&letterbox, |p| p.x < 8.0).unwrap();
        assert_eq!(half.mask.coordinates().count(), 6);
        assert!(found.instance(&letterbox, |_| false).is_none());
        let outside = Detection {
            least: DVec2::splat(90.0),
            most: DVec2::splat(99.0),
            ..found
        };
        assert!(outside.instance(&letterbox, |_| true).is_none());
    }
}
