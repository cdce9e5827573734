//! Outputs of the Mask R-CNN family, as torchvision and Detectron2 export it, suppression included.
//!
//! Boxes [N, 4] are corners in the input's pixels, labels [N] and scores [N] belong to them. Masks are probabilities, either of the whole
//! input [N, 1, height, width] or of each box, [N, 1, 28, 28], stretched over it. A pixel is the object's where they exceed one half.

use glam::DVec2;

use super::detection::{Decoding, Detection, Detector};
use super::error::SegmentError;
use super::instance::Instance;
use super::letterbox::Letterbox;
use super::plane::{Beyond, Plane};
use super::settings::Layout;
use super::tensor::{Output, Tensor, describe};

const NAMES: [&str; 4] = ["boxes", "labels", "scores", "masks"];

/// Least probability of an object's pixel.
const INSIDE: f32 = 0.5;

struct MaskRcnn<'a> {
    boxes: &'a Tensor,
    labels: &'a Tensor,
    scores: &'a Tensor,
    masks: &'a Tensor,
    count: usize,
    /// Of one mask, (width, height).
    size: (usize, usize),
}

/// Instances in the image that `letterbox` put into the model's input.
///
/// # Errors
/// [`SegmentError`] if the outputs are of another layout or not finite.
pub(super) fn instances(
    outputs: &[Output],
    letterbox: &Letterbox,
    decoding: &Decoding,
) -> Result<Vec<Instance>, SegmentError> {
    Ok(MaskRcnn::of(outputs)?.instances(letterbox, decoding))
}

impl<'a> MaskRcnn<'a> {
    fn of(outputs: &'a [Output]) -> Result<Self, SegmentError> {
        let wrong = || SegmentError::Outputs {
            layout: Layout::MaskRcnn.name(),
            found: describe(outputs),
            expected: "boxes [N, 4], labels [N], scores [N] and masks [N, 1, height, width]",
        };
        let [boxes, labels, scores, masks] = in_order(outputs).ok_or_else(wrong)?;
        let (&[count, 4], &[of_masks, 1, height, width]) = (&boxes.shape[..], &masks.shape[..])
        else {
            return Err(wrong());
        };
        let of_each = [labels, scores].map(|t| t.shape[..] == [count]);
        let has_pixels = count == 0 || width * height > 0;
        if of_each != [true, true] || of_masks != count || !has_pixels {
            return Err(wrong());
        }
        boxes.require_finite("a box")?;
        labels.require_finite("a label")?;
        scores.require_finite("a score")?;
        masks.require_finite("a mask")?;
        Ok(Self {
            boxes,
            labels,
            scores,
            masks,
            count,
            size: (width, height),
        })
    }
}

impl Detector for MaskRcnn<'_> {
    fn detections(&self, decoding: &Decoding) -> Vec<Detection> {
        let found = |index: usize| {
            let score = self.scores.values[index];
            // Labels are whole numbers; f32 holds those of any data set exactly.
            let class = *decoding.classes.get(&(self.labels.values[index] as u32))?;
            let corner = |i: usize| f64::from(self.boxes.values[4 * index + i]);
            (score >= decoding.least_score).then(|| Detection {
                class,
                score,
                least: DVec2::new(corner(0), corner(1)),
                most: DVec2::new(corner(2), corner(3)),
                index,
            })
        };
        (0..self.count).filter_map(found).collect()
    }

    fn instance(&self, found: &Detection, letterbox: &Letterbox) -> Option<Instance> {
        let (width, height) = self.size;
        let pixels = width * height;
        let plane = Plane {
            width,
            height,
            values: self.masks.values[found.index * pixels..][..pixels].to_vec(),
        };
        let (input_width, input_height) = letterbox.input_size();
        let of_input = (width, height) == (input_width as usize, input_height as usize);
        let size = DVec2::new(width as f64, height as f64);
        let scale = size / (found.most - found.least);
        found.instance(letterbox, |input_px| {
            let at = if of_input {
                input_px
            } else {
                (input_px - found.least) * scale
            };
            plane.at(at.x, at.y, Beyond::Nothing) > INSIDE
        })
    }
}

/// The outputs by their names, or in their order where an export has lost the names.
fn in_order(outputs: &[Output]) -> Option<[&Tensor; 4]> {
    let named = |name: &str| outputs.iter().find(|o| o.name == name).map(|o| &o.tensor);
    if let [Some(boxes), Some(labels), Some(scores), Some(masks)] = NAMES.map(named) {
        return Some([boxes, labels, scores, masks]);
    }
    let [boxes, labels, scores, masks] = outputs else {
        return None;
    };
    Some([boxes, labels, scores, masks].map(|o| &o.tensor))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::segment::detection::tests::decoding;
    use crate::segment::instance::RoadUser;

    const IMAGE: (u32, u32) = (30, 20);
    const INPUT: (u32, u32) = (60, 60);

    fn output(name: &str, shape: &[usize], values: Vec<f32>) -> Output {
        Output {
            name: name.to_owned(),
            tensor: Tensor::new(shape.to_vec(), values),
        }
    }

    /// Two road users and one of no wanted class. In the image the first is the disc of radius 4 around (9, 8), the second the
    /// rectangle from (20, 3) to (26, 15); the image lies in the input twice as large, ten rows down.
    fn truth(x: f64, y: f64) -> [bool; 2] {
        let disc = (x - 9.0).powi(2) + (y - 8.0).powi(2) < 16.0;
        [disc, (20.0..26.0).contains(&x) && (3.0..15.0).contains(&y)]
    }

    const BOXES: [[f32; 4]; 3] = [
        [10.0, 18.0, 26.0, 34.0],
        [40.0, 16.0, 52.0, 40.0],
        [0.0, 0.0, 9.0, 9.0],
    ];

    fn outputs(masks: Output) -> Vec<Output> {
        vec![
            output("boxes", &[3, 4], BOXES.concat()),
            output("labels", &[3], vec![2.0, 0.0, 1.0]),
            output("scores", &[3], vec![0.7, 0.9, 0.95]),
            masks,
        ]
    }

    /// Masks of `size`, a pixel's value being the share of it that lies in the object; `at` maps a mask's position, 0 to 1, to the input.
    fn masks(size: (usize, usize), at: impl Fn(usize, DVec2) -> DVec2) -> Output {
        let mut values = Vec::new();
        for object in 0..3 {
            for i in 0..size.0 * size.1 {
                let share = (0..16)
                    .filter(|s| {
                        let x = (i % size.0) as f64 + (f64::from(s % 4) + 0.5) / 4.0;
                        let y = (i / size.0) as f64 + (f64::from(s / 4) + 0.5) / 4.0;
                        let p = at(object, DVec2::new(x / size.0 as f64, y / size.1 as f64));
                        object < 2 && truth(p.x / 2.0, (p.y - 10.0) / 2.0)[object]
                    })
                    .count();
                values.push(share as f32 / 16.0);
            }
        }
        output("masks", &[3, 1, size.1, size.0], values)
    }

    fn of_boxes() -> Output {
        masks((28, 28), |object, p| {
            let [x0, y0, x1, y1] = BOXES[object].map(f64::from);
            DVec2::new(x0 + (x1 - x0) * p.x, y0 + (y1 - y0) * p.y)
        })
    }

    fn of_input() -> Output {
        masks((60, 60), |_, p| p * 60.0)
    }

    /// Pixels in which the instances, surest first, and the truth differ.
    fn wrong_pixels(found: &[Instance]) -> usize {
        assert_eq!(found.len(), 2, "{found:?}");
        assert_eq!(found[0].class, RoadUser::Pedestrian);
        assert_eq!(found[1].class, RoadUser::Vehicle);
        let mut wrong = 0;
        for (instance, object) in found.iter().zip([1, 0]) {
            let pixels: Vec<_> = instance.mask.coordinates().collect();
            for y in 0..IMAGE.1 {
                for x in 0..IMAGE.0 {
                    let is = truth(f64::from(x) + 0.5, f64::from(y) + 0.5)[object];
                    wrong += usize::from(is != pixels.contains(&(x, y)));
                }
            }
        }
        wrong
    }

    #[test]
    fn masks_of_boxes_and_of_the_input_are_the_same_objects() {
        let letterbox = Letterbox::new(IMAGE, INPUT);
        for masks in [of_boxes(), of_input()] {
            let found = instances(&outputs(masks), &letterbox, &decoding()).unwrap();
            assert_eq!(wrong_pixels(&found), 0);
        }
        // Broken on purpose: masks of boxes that lie one row of boxes off, and an image that is thought to fill the input.
        let mut shifted = of_boxes();
        shifted.tensor.values.rotate_right(28 * 5);
        let found = instances(&outputs(shifted), &letterbox, &decoding()).unwrap();
        assert!(wrong_pixels(&found) > 10);
        let stretched = Letterbox::new((30, 30), INPUT);
        let found = instances(&outputs(of_input()), &stretched, &decoding()).unwrap();
        assert!(wrong_pixels(&found) > 10);
    }

    #[test]
    fn outputs_are_found_by_name_or_else_by_order() {
        let letterbox = Letterbox::new(IMAGE, INPUT);
        let decode = |outputs: &[Output]| instances(outputs, &letterbox, &decoding());
        let mut mixed = outputs(of_boxes());
        mixed.rotate_left(1);
        assert_eq!(wrong_pixels(&decode(&mixed).unwrap()), 0);
        for (i, output) in mixed.iter_mut().enumerate() {
            output.name = format!("{}", 900 + i);
        }
        let error = decode(&mixed).unwrap_err().to_string();
        assert!(error.contains("903 [3, 4]"), "{error}");
        mixed.rotate_right(1);
        assert_eq!(wrong_pixels(&decode(&mixed).unwrap()), 0);
    }

    #[test]
    fn an_image_without_road_users_has_no_instance() {
        let nothing = [
            output("boxes", &[0, 4], Vec::new()),
            output("labels", &[0], Vec::new()),
            output("scores", &[0], Vec::new()),
            output("masks", &[0, 1, 28, 28], Vec::new()),
        ];
        let letterbox = Letterbox::new(IMAGE, INPUT);
        assert_eq!(instances(&nothing, &letterbox, &decoding()).unwrap(), []);
    }

    #[test]
    fn a_mask_that_is_not_a_number_is_refused() {
        let mut masks = of_boxes();
        masks.tensor.values[5] = f32::INFINITY;
        let letterbox = Letterbox::new(IMAGE, INPUT);
        let error = instances(&outputs(masks), &letterbox, &decoding()).unwrap_err();
        assert!(error.to_string().contains("a mask"), "{error}");
    }
}
