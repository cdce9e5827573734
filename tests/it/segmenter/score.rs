//! How what a segmenter finds compares with the truth.

use std::collections::BTreeMap;

use backlot_client::read_log::ReadLog;
use backlot_e2e::damaged_masks::{Mask, read_mask};
use backlot_e2e::painted;
use backlot_proto::v1;
use backlot_server::segment::{Instance, RgbImage, Segmenter};

/// Objects of which less is seen are smaller than the cells that a mask is made of.
const LEAST_PX: usize = 150;

/// Decoded image of a frame.
pub(super) fn image(log: &ReadLog, frame: &v1::CameraFrame) -> image::RgbImage {
    let bytes = log.blobs[&frame.image.as_ref().unwrap().digest]
        .read()
        .unwrap();
    image::load_from_memory(&bytes).unwrap().into_rgb8()
}

pub(super) fn segment(segmenter: &dyn Segmenter, image: &image::RgbImage) -> Vec<Instance> {
    let image = RgbImage {
        size: image.dimensions(),
        pixels: image.as_raw(),
    };
    segmenter.segment(image).unwrap()
}

/// One frame in so many is looked at: networks are slow where they are not optimised.
const EVERY: usize = 5;

/// The frames that are compared.
pub(super) fn looked_at(log: &ReadLog) -> impl Iterator<Item = &v1::CameraFrame> {
    log.drive_log.frames.iter().step_by(EVERY)
}

/// Overlaps of objects with what was found of them.
#[derive(Debug, Default)]
pub(super) struct Score {
    /// Objects large enough, of a class that is mapped.
    pub(super) wanted: usize,
    /// Of each of those: the largest overlap of an instance with it.
    ious: Vec<f64>,
    /// Instances that are no wanted object's.
    false_instances: usize,
}

impl Score {
    pub(super) fn of(log: &ReadLog, segmenter: &dyn Segmenter) -> Self {
        let mut score = Self::default();
        for frame in looked_at(log) {
            let truth = read_mask(log, frame.instance_mask.as_ref().unwrap());
            let found = segment(segmenter, &image(log, frame));
            score.add(&truth, &found);
        }
        score
    }

    pub(super) fn add(&mut self, truth: &Mask, found: &[Instance]) {
        let mut sizes: BTreeMap<u16, usize> = BTreeMap::new();
        for value in truth.pixels() {
            *sizes.entry(value.0[0]).or_default() += 1;
        }
        let is_mapped = |value: u16| {
            let track = usize::from(value).wrapping_sub(1);
            track < painted::palette().len() && track % painted::CLASSES != 1
        };
        let mut best: BTreeMap<u16, f64> = BTreeMap::new();
        for instance in found {
            let mut shared: BTreeMap<u16, usize> = BTreeMap::new();
            let mut pixels = 0;
            for (x, y) in instance.mask.coordinates() {
                let value = truth.get_pixel_checked(x, y).map_or(0, |value| value.0[0]);
                *shared.entry(value).or_default() += 1;
                pixels += 1;
            }
            let (&value, &most) = shared.iter().max_by_key(|(_, count)| **count).unwrap();
            let iou = most as f64 / (sizes[&value] + pixels - most) as f64;
            if is_mapped(value) {
                let known = best.entry(value).or_default();
                *known = known.max(iou);
            } else {
                self.false_instances += 1;
            }
        }
        for (value, _) in sizes
            .iter()
            .filter(|(v, px)| is_mapped(**v) && **px >= LEAST_PX)
        {
            self.wanted += 1;
            self.ious.push(best.get(value).copied().unwrap_or_default());
        }
    }

    pub(super) fn mean_iou(&self) -> f64 {
        self.ious.iter().sum::<f64>() / self.wanted.max(1) as f64
    }

    pub(super) fn worst_iou(&self) -> f64 {
        self.ious.iter().copied().fold(1.0, f64::min)
    }

    pub(super) fn is_right(&self) -> bool {
        self.false_instances == 0 && self.mean_iou() > 0.9 && self.worst_iou() > 0.75
    }
}
