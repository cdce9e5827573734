//! Masks of a segmenter for the frames of a log that bring none.

use std::collections::BTreeMap;
use std::io::Cursor;

use image::{ImageBuffer, ImageFormat, Luma};
use serde::{Deserialize, Serialize};

use super::content::LogBlobs;
use super::frame::{FrameError, read_image};
use super::free_masks::{LogMasks, MaskSource};
use super::image::decode_rgb;
use crate::domain::blob::{BlobRef, Digest};
use crate::domain::drive_log::{CameraFrame, DriveLog};
use crate::segment::{LabelledInstance, RgbImage, RoadUser, Segmenter, label_image};
use backlot_engine::camera::Camera;

/// What a segmenter found in a log.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Segmentation {
    /// The segmenter's name, for people.
    pub name: String,
    /// [`Segmenter::digest`].
    pub digest: Digest,
    /// By index into the log's frames; frames with masks of their own are absent.
    pub frames: BTreeMap<usize, SegmentedFrame>,
}

/// The instances of one frame, as decompositions keep them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct SegmentedFrame {
    pub camera_id: String,
    pub frame_index: u32,
    /// 16-bit grey PNG of the camera's size, as `CameraFrame::free_instance_mask`.
    pub mask: BlobRef,
    /// Best first.
    pub instances: Vec<LabelledInstance>,
}

/// Segments every frame that brings no masks; `write` puts a mask on stable storage. `progress` hears (frames done, frames) before each
/// image and says whether to go on.
///
/// # Errors
/// [`FrameError`] of the first frame that cannot be read or segmented, or what `write` says. `Ok(None)` if `progress` said stop.
pub(crate) fn segment_log<B: LogBlobs>(
    log: &DriveLog,
    blobs: &B,
    segmenter: &dyn Segmenter,
    mut write: impl FnMut(&[u8]) -> Result<BlobRef, B::Error>,
    mut progress: impl FnMut(usize, usize) -> bool,
) -> Result<Option<Segmentation>, FrameError<B::Error>> {
    let mut found = Segmentation {
        name: segmenter.name().to_owned(),
        digest: segmenter.digest(),
        frames: BTreeMap::new(),
    };
    for (index, frame) in log.frames.iter().enumerate() {
        let brings_masks = frame.instance_mask.is_some() || frame.free_instance_mask.is_some();
        let Some(camera) = log.camera(&frame.camera_id).filter(|_| !brings_masks) else {
            continue;
        };
        if !progress(index, log.frames.len()) {
            return Ok(None);
        }
        let labelled = segment_frame(frame, &camera.camera, blobs, segmenter)?;
        let segmented = SegmentedFrame {
            camera_id: frame.camera_id.clone(),
            frame_index: frame.frame_index,
            mask: write(&labelled.mask_png).map_err(FrameError::Blob)?,
            instances: labelled.instances,
        };
        found.frames.insert(index, segmented);
    }
    Ok(Some(found))
}

struct Labelled {
    mask_png: Vec<u8>,
    instances: Vec<LabelledInstance>,
}

fn segment_frame<B: LogBlobs>(
    frame: &CameraFrame,
    camera: &Camera,
    blobs: &B,
    segmenter: &dyn Segmenter,
) -> Result<Labelled, FrameError<B::Error>> {
    let size = (camera.width, camera.height);
    let pixels = read_image(blobs, frame, "image", &frame.image, |b| decode_rgb(b, size))?;
    let image = RgbImage {
        size,
        pixels: &pixels,
    };
    let instances = segmenter.segment(image);
    let instances = instances.map_err(|source| FrameError::Segment {
        camera_id: frame.camera_id.clone(),
        frame_index: frame.frame_index,
        source,
    })?;
    let (labels, instances) = label_image(&instances, size);
    Ok(Labelled {
        mask_png: encode_mask(labels, size),
        instances,
    })
}

/// An instance mask as a 16-bit grey PNG; `mask` is row-major of `size`, (width, height).
pub(crate) fn encode_mask(mask: Vec<u16>, size: (u32, u32)) -> Vec<u8> {
    let image: ImageBuffer<Luma<u16>, _> =
        ImageBuffer::from_raw(size.0, size.1, mask).expect("a mask is of its size");
    let mut out = Cursor::new(Vec::new());
    image
        .write_to(&mut out, ImageFormat::Png)
        .expect("grey images encode in memory");
    out.into_inner()
}

impl Segmentation {
    /// The log with the masks as if it had brought them.
    pub(crate) fn over(&self, mut log: DriveLog) -> DriveLog {
        for (&index, segmented) in &self.frames {
            log.frames[index].free_instance_mask = Some(segmented.mask);
        }
        log
    }

    /// For people: how much was found in how many frames.
    pub(crate) fn summary(&self) -> String {
        let instances: usize = self.frames.values().map(|f| f.instances.len()).sum();
        let (frames, name) = (self.frames.len(), &self.name);
        format!("{name} found {instances} road users in the {frames} frames without masks")
    }
}

/// Masks of a log and the segmenter's, which know their classes.
#[derive(Debug)]
pub(crate) struct ClassedMasks<'a, B> {
    pub blobs: &'a B,
    pub segmentation: Option<&'a Segmentation>,
}

impl<B: LogBlobs> MaskSource for ClassedMasks<'_, B> {
    type Error = B::Error;

    fn free_masks(
        &self,
        frame: &CameraFrame,
        camera: &Camera,
    ) -> Result<Option<Vec<u16>>, FrameError<B::Error>> {
        LogMasks(self.blobs).free_masks(frame, camera)
    }

    fn class_of(&self, frame: usize, mask: u16) -> Option<RoadUser> {
        let found = self.segmentation?.frames.get(&frame)?;
        let instance = found.instances.iter().find(|i| i.value == mask);
        instance.map(|i| i.class)
    }
}
