//! Where the labels of a log's training sets come from: made now, or read from an earlier decomposition of the same inputs.

use std::collections::HashMap;

use backlot_engine::view::PixelLabel;

use super::background_labels::background_labels;
use super::content::LogBlobs;
use super::decomposition::{Decomposition, ObjectPixels, decode_labels};
use super::frame::{FrameError, LoadedFrame, read_image};
use super::matched_masks::MatchedMasks;
use super::object::labelled_object;
use super::object_labels::Crop;
use super::object_plan::Rejection;
use crate::domain::blob::BlobRef;
use crate::domain::drive_log::{CameraFrame, DriveLog};

/// Labels of a log's pixels.
#[derive(Clone, Debug)]
pub enum LogLabels {
    /// Made from the frames; masks that name no track are matched.
    Made(MatchedMasks),
    Stored(StoredLabels),
}

impl Default for LogLabels {
    /// Made, for logs that bring no free masks.
    fn default() -> Self {
        Self::Made(MatchedMasks::default())
    }
}

/// The label images of a stored decomposition.
#[derive(Clone, Debug, Default)]
pub struct StoredLabels {
    background: HashMap<(String, u32), BlobRef>,
    objects: HashMap<(String, String, u32), ObjectPixels>,
}

impl StoredLabels {
    pub(crate) fn new(decomposition: &Decomposition) -> Self {
        let background = decomposition
            .background
            .iter()
            .map(|frame| ((frame.camera_id.clone(), frame.frame_index), frame.labels));
        let objects = decomposition.objects.iter().flat_map(|track| {
            track.frames.iter().map(|frame| {
                let key = (
                    track.track_id.clone(),
                    frame.camera_id.clone(),
                    frame.frame_index,
                );
                (key, frame.found.clone())
            })
        });
        Self {
            background: background.collect(),
            objects: objects.collect(),
        }
    }
}

/// The object's surroundings in the image and their labels, or why the frame does not show it.
pub(super) type ObjectLabels = Result<(Crop, Vec<PixelLabel>), Rejection>;

impl LogLabels {
    /// The masks that frames are loaded with; `None` if labels need none.
    pub(super) fn masks(&self) -> Option<&MatchedMasks> {
        match self {
            Self::Made(masks) => Some(masks),
            Self::Stored(_) => None,
        }
    }

    /// Labels of a frame's pixels to the background, row-major.
    pub(super) fn background<B: LogBlobs>(
        &self,
        log: &DriveLog,
        blobs: &B,
        moving: &[bool],
        loaded: &LoadedFrame,
    ) -> Result<Vec<PixelLabel>, FrameError<B::Error>> {
        let Self::Stored(stored) = self else {
            return Ok(background_labels(log, moving, loaded));
        };
        let frame = &loaded.frame;
        let labels = stored
            .background
            .get(&(frame.camera_id.clone(), frame.frame_index))
            .ok_or_else(|| missing(frame))?;
        let size = (loaded.camera.width, loaded.camera.height);
        read_image(blobs, frame, "label image", labels, |bytes| {
            decode_labels(bytes, size)
        })
    }

    /// Labels of the pixels around a track's object.
    pub(super) fn object<B: LogBlobs>(
        &self,
        log: &DriveLog,
        blobs: &B,
        track: usize,
        loaded: &LoadedFrame,
    ) -> Result<ObjectLabels, FrameError<B::Error>> {
        let Self::Stored(stored) = self else {
            return Ok(labelled_object(log, track, loaded));
        };
        let frame = &loaded.frame;
        let key = (
            log.tracks[track].track_id.clone(),
            frame.camera_id.clone(),
            frame.frame_index,
        );
        match stored.objects.get(&key).ok_or_else(|| missing(frame))? {
            ObjectPixels::Rejected(reason) => Ok(Err(*reason)),
            ObjectPixels::Kept { crop, labels } => {
                let size = (crop.width as u32, crop.height as u32);
                let labels = read_image(blobs, frame, "label image", labels, |bytes| {
                    decode_labels(bytes, size)
                })?;
                Ok(Ok((*crop, labels)))
            }
        }
    }
}

/// The digest of the inputs says that it is there.
fn missing<E>(frame: &CameraFrame) -> FrameError<E> {
    FrameError::Manifest {
        camera_id: frame.camera_id.clone(),
        frame_index: frame.frame_index,
        what: "is missing in the stored decomposition",
    }
}
