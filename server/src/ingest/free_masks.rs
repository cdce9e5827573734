//! Instance masks that are not tied to tracks, wherever they come from.

use std::collections::BTreeSet;

use backlot_engine::camera::Camera;

use super::content::LogBlobs;
use super::frame::{FrameError, read_image};
use super::image::decode_instance_mask;
use crate::domain::drive_log::{CameraFrame, MASK_NONE, MASK_UNKNOWN};
use crate::segment::RoadUser;

/// More road users than an image can show apart.
pub(super) const MAX_FREE_INSTANCES: usize = 1_000;

/// What finds the instances in a frame without knowing the log's tracks: the log itself, or a segmenter.
pub trait MaskSource {
    /// The blob store's own error.
    type Error;

    /// One value a pixel, row-major: [`MASK_NONE`], [`MASK_UNKNOWN`], or an instance of this frame alone, at most 1,000 of them.
    /// `None` if the source knows nothing about the frame.
    ///
    /// # Errors
    /// [`FrameError`] if the frame cannot be read.
    fn free_masks(
        &self,
        frame: &CameraFrame,
        camera: &Camera,
    ) -> Result<Option<Vec<u16>>, FrameError<Self::Error>>;

    /// What an instance is, by the frame's index in the log and the mask's value; `None` if the source cannot tell.
    fn class_of(&self, _frame: usize, _mask: u16) -> Option<RoadUser> {
        None
    }
}

/// The free masks that a log brings.
#[derive(Debug)]
pub struct LogMasks<'a, B>(pub &'a B);

impl<B: LogBlobs> MaskSource for LogMasks<'_, B> {
    type Error = B::Error;

    fn free_masks(
        &self,
        frame: &CameraFrame,
        camera: &Camera,
    ) -> Result<Option<Vec<u16>>, FrameError<B::Error>> {
        let Some(blob) = &frame.free_instance_mask else {
            return Ok(None);
        };
        let size = (camera.width, camera.height);
        read_image(self.0, frame, "free instance mask", blob, |bytes| {
            decode_instance_mask(bytes, size)
        })
        .map(Some)
    }
}

/// The values of a free mask that are instances, ascending.
pub(super) fn instances(mask: &[u16]) -> Vec<u16> {
    let mut found = BTreeSet::new();
    let mut last = MASK_NONE;
    for &value in mask {
        if value != last {
            last = value;
            found.insert(value);
        }
    }
    found
        .into_iter()
        .filter(|&v| v != MASK_NONE && v != MASK_UNKNOWN)
        .collect()
}
