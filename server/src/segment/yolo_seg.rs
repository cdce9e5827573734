//! Outputs of the YOLO-seg family (YOLOv5-seg to YOLO11-seg as Ultralytics exports them, without built-in suppression).
//!
//! The first output is [1, 4 + classes + coefficients, boxes]: centre and size of each box in the input's pixels, class scores after the
//! sigmoid, mask coefficients. The second is [1, coefficients, height, width]: prototypes. A box's mask is where the sum of the prototypes
//! by its coefficients is positive, that is where the sigmoid of it exceeds one half.

use glam::DVec2;

use super::detection::{Decoding, Detection, Detector};
use super::error::SegmentError;
use super::instance::Instance;
use super::letterbox::Letterbox;
use super::plane::{Beyond, Plane};
use super::settings::Layout;
use super::tensor::{Output, Tensor, describe};

/// Rows of the first output before the class scores.
const BOX_ROWS: usize = 4;

/// The outputs, their shapes checked.
struct Yolo<'a> {
    /// [rows, boxes].
    rows: &'a Tensor,
    /// [coefficients, height, width].
    prototypes: &'a Tensor,
    boxes: usize,
    classes: usize,
    coefficients: usize,
    /// Of the prototypes, (width, height).
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
    Ok(Yolo::of(outputs)?.instances(letterbox, decoding))
}

impl<'a> Yolo<'a> {
    fn of(outputs: &'a [Output]) -> Result<Self, SegmentError> {
        let wrong = || SegmentError::Outputs {
            layout: Layout::YoloSeg.name(),
            found: describe(outputs),
            expected: "[1, 4 + classes + coefficients, boxes] and [1, coefficients, height, width]",
        };
        let [rows, prototypes] = outputs else {
            return Err(wrong());
        };
        let (&[1, row_count, boxes], &[1, coefficients, height, width]) =
            (&rows.tensor.shape[..], &prototypes.tensor.shape[..])
        else {
            return Err(wrong());
        };
        let classes = row_count.checked_sub(BOX_ROWS + coefficients);
        let classes = classes.filter(|c| *c > 0 && coefficients * height * width > 0);
        let classes = classes.ok_or_else(wrong)?;
        rows.tensor.require_finite("a box, score or coefficient")?;
        prototypes.tensor.require_finite("a prototype")?;
        Ok(Self {
            rows: &rows.tensor,
            prototypes: &prototypes.tensor,
            boxes,
            classes,
            coefficients,
            size: (width, height),
        })
    }

    fn value(&self, row: usize, index: usize) -> f32 {
        self.rows.values[row * self.boxes + index]
    }

    fn best_class(&self, index: usize) -> (u32, f32) {
        let score = |class: usize| self.value(BOX_ROWS + class, index);
        let mut best = (0, score(0));
        for class in 1..self.classes {
            if score(class) > best.1 {
                best = (class as u32, score(class));
            }
        }
        best
    }

    /// The sum of the prototypes by a box's coefficients, over a part of them.
    fn logits(
        &self,
        index: usize,
        columns: std::ops::Range<usize>,
        rows: std::ops::Range<usize>,
    ) -> Plane {
        let (width, height) = self.size;
        let mut sum = vec![0.0; columns.len() * rows.len()];
        for k in 0..self.coefficients {
            let coefficient = self.value(BOX_ROWS + self.classes + k, index);
            let prototype = &self.prototypes.values[k * width * height..][..width * height];
            for (line, row) in sum.chunks_exact_mut(columns.len()).zip(rows.clone()) {
                let from = &prototype[row * width..][columns.clone()];
                for (sum, value) in line.iter_mut().zip(from) {
                    *sum += coefficient * value;
                }
            }
        }
        Plane {
            width: columns.len(),
            height: rows.len(),
            values: sum,
        }
    }
}

impl Detector for Yolo<'_> {
    /// By the best class of each box.
    fn detections(&self, decoding: &Decoding) -> Vec<Detection> {
        let found = |index: usize| {
            let (class, score) = self.best_class(index);
            let class = *decoding.classes.get(&class)?;
            if score < decoding.least_score {
                return None;
            }
            let part = |row: usize| f64::from(self.value(row, index));
            let centre = DVec2::new(part(0), part(1));
            let half = DVec2::new(part(2), part(3)) / 2.0;
            Some(Detection {
                class,
                score,
                least: centre - half,
                most: centre + half,
                index,
            })
        };
        (0..self.boxes).filter_map(found).collect()
    }

    fn instance(&self, found: &Detection, letterbox: &Letterbox) -> Option<Instance> {
        let (width, height) = letterbox.input_size();
        let scale = DVec2::new(
            self.size.0 as f64 / f64::from(width),
            self.size.1 as f64 / f64::from(height),
        );
        // The prototypes' pixels that the box reaches, and one more for reading between them.
        let first = |at: f64, end: usize| ((at - 0.5).floor().max(0.0) as usize).min(end - 1);
        let end = |at: f64, end: usize| ((at + 1.5).ceil().max(1.0) as usize).min(end);
        let (least, most) = (found.least * scale, found.most * scale);
        let columns = first(least.x, self.size.0)..end(most.x, self.size.0);
        let rows = first(least.y, self.size.1)..end(most.y, self.size.1);
        if columns.is_empty() || rows.is_empty() {
            return None;
        }
        let start = DVec2::new(columns.start as f64, rows.start as f64);
        let plane = self.logits(found.index, columns, rows);
        found.instance(letterbox, |input_px| {
            let at = input_px * scale - start;
            plane.at(at.x, at.y, Beyond::Same) > 0.0
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::segment::detection::suppress;
    use crate::segment::detection::tests::decoding;
    use proptest::prelude::*;

    const INPUT: (u32, u32) = (32, 24);
    const IMAGE: (u32, u32) = (40, 20);
    const CLASSES: usize = 3;
    const COEFFICIENTS: usize = 2;

    fn output(name: &str, shape: &[usize], values: Vec<f32>) -> Output {
        Output {
            name: name.to_owned(),
            tensor: Tensor::new(shape.to_vec(), values),
        }
    }

    /// Random outputs: boxes anywhere, some over the border, and prototypes of both signs.
    fn outputs() -> impl Strategy<Value = Vec<Output>> {
        let (width, height) = (INPUT.0 as usize / 4, INPUT.1 as usize / 4);
        let rows = BOX_ROWS + CLASSES + COEFFICIENTS;
        let boxes = prop::collection::vec(prop::collection::vec(0.0..1.0_f32, rows), 1..9);
        let prototypes = prop::collection::vec(-1.0..1.0_f32, COEFFICIENTS * width * height);
        (boxes, prototypes).prop_map(move |(boxes, prototypes)| {
            let scale = |row: usize, v: f32| match row {
                0 => v * 40.0 - 4.0,
                1 => v * 30.0 - 3.0,
                2 | 3 => 1.0 + v * 20.0,
                _ if row < BOX_ROWS + CLASSES => v,
                _ => v * 2.0 - 1.0,
            };
            let values = (0..rows).flat_map(|r| boxes.iter().map(move |b| scale(r, b[r])));
            vec![
                output("output0", &[1, rows, boxes.len()], values.collect()),
                output("output1", &[1, COEFFICIENTS, height, width], prototypes),
            ]
        })
    }

    /// The definition, pixel by pixel: enlarge the prototypes' sum to the input bilinearly, cut it at the box, and read it where the
    /// image's centre lies.
    fn defined(outputs: &[Output], letterbox: &Letterbox, found: &Detection) -> Vec<(u32, u32)> {
        let (rows, prototypes) = (&outputs[0].tensor, &outputs[1].tensor);
        let boxes = rows.shape[2];
        let (height, width) = (prototypes.shape[2], prototypes.shape[3]);
        let mut sum = vec![0.0_f64; width * height];
        for k in 0..COEFFICIENTS {
            let c = rows.values[(BOX_ROWS + CLASSES + k) * boxes + found.index];
            for (i, sum) in sum.iter_mut().enumerate() {
                *sum += f64::from(c) * f64::from(prototypes.values[k * width * height + i]);
            }
        }
        let read = |p: DVec2| {
            let mut value = 0.0;
            for (i, sum) in sum.iter().enumerate() {
                // Tents around every centre; beyond the border the outermost centres are repeated.
                let (x, y) = ((i % width) as f64 + 0.5, (i / width) as f64 + 0.5);
                let p = p.clamp(
                    DVec2::splat(0.5),
                    DVec2::new(width as f64 - 0.5, height as f64 - 0.5),
                );
                value += sum * (1.0 - (p.x - x).abs()).max(0.0) * (1.0 - (p.y - y).abs()).max(0.0);
            }
            value
        };
        let mut pixels = Vec::new();
        for y in 0..IMAGE.1 {
            for x in 0..IMAGE.0 {
                let at =
                    letterbox.input_from_image(DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5));
                let in_box = at.cmpge(found.least).all() && at.cmplt(found.most).all();
                if in_box && read(at / 4.0) > 0.0 {
                    pixels.push((x, y));
                }
            }
        }
        pixels
    }

    fn agrees(found: &[Instance], expected: &[Vec<(u32, u32)>]) -> bool {
        let found: Vec<Vec<_>> = found
            .iter()
            .map(|i| i.mask.coordinates().collect())
            .collect();
        found == expected
    }

    proptest! {
        #[test]
        fn masks_are_those_of_the_definition(outputs in outputs()) {
            let letterbox = Letterbox::new(IMAGE, INPUT);
            let found = instances(&outputs, &letterbox, &decoding()).unwrap();
            let yolo = Yolo::of(&outputs).unwrap();
            let kept = suppress(yolo.detections(&decoding()), decoding().most_iou);
            let defined_by = |letterbox: &Letterbox| -> Vec<Vec<(u32, u32)>> {
                let masks = kept.iter().map(|d| defined(&outputs, letterbox, d));
                masks.filter(|mask| !mask.is_empty()).collect()
            };
            prop_assert!(agrees(&found, &defined_by(&letterbox)));
            // Broken on purpose: read as if the image filled the input.
            let large = found.iter().any(|i| i.mask.coordinates().count() > 30);
            if large {
                let stretched = Letterbox::new((40, 30), INPUT);
                prop_assert!(!agrees(&found, &defined_by(&stretched)));
            }
        }

        #[test]
        fn boxes_are_those_that_a_scan_finds(outputs in outputs()) {
            let yolo = Yolo::of(&outputs).unwrap();
            let rows = &outputs[0].tensor;
            let boxes = rows.shape[2];
            let mut expected = Vec::new();
            for i in 0..boxes {
                let of = |r: usize| rows.values[r * boxes + i];
                let scores = [of(4), of(5), of(6)];
                let best = scores.iter().copied().fold(0.0, f32::max);
                if best >= 0.4 && best != scores[1] {
                    expected.push((i, best, f64::from(of(0)) - f64::from(of(2)) / 2.0));
                }
            }
            let found: Vec<_> = yolo.detections(&decoding()).iter()
                .map(|d| (d.index, d.score, d.least.x)).collect();
            prop_assert_eq!(found, expected);
        }
    }

    #[test]
    fn other_layouts_and_values_are_refused() {
        let letterbox = Letterbox::new(IMAGE, INPUT);
        let decode = |outputs: &[Output]| instances(outputs, &letterbox, &decoding());
        let good = |rows: Vec<f32>| {
            vec![
                output("output0", &[1, 9, 1], rows),
                output("output1", &[1, 2, 6, 8], vec![1.0; 96]),
            ]
        };
        assert!(decode(&good(vec![0.5; 9])).is_ok());
        let mut nan = vec![0.5; 9];
        nan[8] = f32::NAN;
        let error = decode(&good(nan)).unwrap_err().to_string();
        assert!(error.contains("not a number"), "{error}");
        // As models for detection alone are, and with more coefficients than there are rows.
        for bad in [
            vec![output("output0", &[1, 84, 2], vec![0.0; 168])],
            vec![
                output("output0", &[1, 6, 2], vec![0.0; 12]),
                output("output1", &[1, 2, 1, 1], vec![0.0; 2]),
            ],
            vec![
                output("output0", &[1, 9], vec![0.0; 9]),
                output("output1", &[1, 2, 6, 8], vec![1.0; 96]),
            ],
            Vec::new(),
        ] {
            let error = decode(&bad).unwrap_err().to_string();
            assert!(error.contains("yolo-seg has [1, 4 + classes"), "{error}");
        }
    }
}
