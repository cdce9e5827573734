//! A segmenter made of a network and what its outputs mean.

use super::detection::Decoding;
use super::error::SegmentError;
use super::instance::Instance;
use super::letterbox::{Letterbox, Normalisation};
use super::segmenter::{RgbImage, Segmenter};
use super::settings::Layout;
use super::tensor::Runtime;
use super::{mask_rcnn, yolo_seg};
use crate::domain::blob::Digest;

#[derive(Debug)]
pub(super) struct ModelSegmenter {
    pub name: String,
    pub digest: Digest,
    pub runtime: Box<dyn Runtime>,
    pub layout: Layout,
    /// Width and height.
    pub input_px: (u32, u32),
    pub normalisation: Normalisation,
    pub decoding: Decoding,
}

impl Segmenter for ModelSegmenter {
    fn segment(&self, image: RgbImage<'_>) -> Result<Vec<Instance>, SegmentError> {
        let letterbox = Letterbox::new(image.size, self.input_px);
        let input = letterbox.tensor(image, &self.normalisation);
        let outputs = self.runtime.run(&input)?;
        match self.layout {
            Layout::YoloSeg => yolo_seg::instances(&outputs, &letterbox, &self.decoding),
            Layout::MaskRcnn => mask_rcnn::instances(&outputs, &letterbox, &self.decoding),
        }
    }

    fn digest(&self) -> Digest {
        self.digest
    }

    fn name(&self) -> &str {
        &self.name
    }
}
