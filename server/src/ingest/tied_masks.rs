//! Free masks tied to the tracks they were matched to, kept so that compositions cut movers out by them.

use serde::{Deserialize, Serialize};

use super::content::LogBlobs;
use super::frame::FrameError;
use super::free_masks::{LogMasks, MaskSource};
use super::matched_masks::MatchedMasks;
use super::segmented::encode_mask;
use crate::domain::blob::BlobRef;
use crate::domain::drive_log::DriveLog;

/// The mask of a frame whose log names no tracks in it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct TiedMask {
    pub camera_id: String,
    pub frame_index: u32,
    /// 16-bit grey PNG of the camera's size, as `CameraFrame::instance_mask`; pixels of refused masks are unknown.
    pub mask: BlobRef,
}

/// Ties every free mask of the log; `write` puts one on stable storage. `progress` hears (frames done, frames) and says whether to go on.
///
/// # Errors
/// [`FrameError`] of the first frame that cannot be read, or what `write` says. `Ok(None)` if `progress` said stop.
pub(crate) fn tie_masks<B: LogBlobs>(
    log: &DriveLog,
    blobs: &B,
    masks: &MatchedMasks,
    mut write: impl FnMut(&[u8]) -> Result<BlobRef, B::Error>,
    mut progress: impl FnMut(usize, usize) -> bool,
) -> Result<Option<Vec<TiedMask>>, FrameError<B::Error>> {
    let mut tied = Vec::new();
    for (index, frame) in log.frames.iter().enumerate() {
        let names_tracks = frame.instance_mask.is_some();
        let Some(camera) = log.camera(&frame.camera_id).filter(|_| !names_tracks) else {
            continue;
        };
        let Some(free) = LogMasks(blobs).free_masks(frame, &camera.camera)? else {
            continue;
        };
        if !progress(index, log.frames.len()) {
            return Ok(None);
        }
        let size = (camera.camera.width, camera.camera.height);
        let mask = encode_mask(masks.tie(index, free), size);
        tied.push(TiedMask {
            camera_id: frame.camera_id.clone(),
            frame_index: frame.frame_index,
            mask: write(&mask).map_err(FrameError::Blob)?,
        });
    }
    Ok(Some(tied))
}
