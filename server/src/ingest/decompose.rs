//! Decomposes a whole log once: the labels of its background and of every promising track, put on stable storage.

use super::background::{background_frames, time_order};
use super::background_labels::{background_labels, moving_tracks};
use super::content::LogBlobs;
use super::decomposition::{
    DECOMPOSITION_VERSION, Decomposition, LabelledFrame, LabelledTrack, ObjectFrame, ObjectPixels,
    StoredSegmentation, encode_labels,
};
use super::frame::{FrameError, FrameLoader, LoadedFrame};
use super::matched_masks::MatchedMasks;
use super::object::{labelled_object, view_frames};
use super::object_plan::TrackPlan;
use super::segmented::Segmentation;
use super::tied_masks::tie_masks;
use crate::domain::blob::{BlobRef, Digest};
use crate::domain::drive_log::DriveLog;

/// What is decomposed.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Subject<'a> {
    /// With the masks of the segmentation.
    pub log: &'a DriveLog,
    pub segmentation: Option<&'a Segmentation>,
    pub masks: &'a MatchedMasks,
    /// Tracks with enough frames.
    pub plans: &'a [TrackPlan],
    pub inputs: Digest,
}

/// Labels every frame; `write` puts a label image on stable storage. `progress` hears (frames done, frames) and says whether to go on.
///
/// # Errors
/// [`FrameError`] of the first frame that cannot be loaded, or what `write` says. `Ok(None)` if `progress` said stop.
pub(crate) fn decompose<B: LogBlobs>(
    subject: &Subject<'_>,
    blobs: &B,
    mut write: impl FnMut(&[u8]) -> Result<BlobRef, B::Error>,
    mut progress: impl FnMut(usize, usize) -> bool,
) -> Result<Option<Decomposition>, FrameError<B::Error>> {
    let Subject { log, masks, .. } = *subject;
    let mut made = empty(subject);
    let moving = moving_tracks(log);
    let in_background = background_frames(log);
    let views: Vec<Vec<usize>> = subject.plans.iter().map(view_frames).collect();
    let order = time_order(log);
    let mut loader = FrameLoader::new(log, blobs, Some(masks));
    for (done, &index) in order.iter().enumerate() {
        if !progress(done, 2 * order.len()) {
            return Ok(None);
        }
        let tracks: Vec<usize> = (0..views.len())
            .filter(|&t| views[t].contains(&index))
            .collect();
        if !in_background[index] && tracks.is_empty() {
            continue;
        }
        let loaded = loader.load(index)?;
        if in_background[index] {
            let labels = background_labels(log, &moving, &loaded);
            let size = (loaded.camera.width, loaded.camera.height);
            made.background.push(LabelledFrame {
                camera_id: loaded.frame.camera_id.clone(),
                frame_index: loaded.frame.frame_index,
                labels: write(&encode_labels(&labels, size)).map_err(FrameError::Blob)?,
            });
        }
        for track in tracks {
            let frame = object_frame(log, subject.plans[track].track, &loaded, &mut write);
            let frame = frame.map_err(FrameError::Blob)?;
            made.objects[track].frames.push(frame);
        }
    }
    let tied = tie_masks(log, blobs, masks, write, |done, count| {
        progress(order.len() + done, order.len() + count)
    })?;
    Ok(tied.map(|tied| Decomposition {
        tied_masks: tied,
        ..made
    }))
}

fn empty(subject: &Subject<'_>) -> Decomposition {
    Decomposition {
        version: DECOMPOSITION_VERSION,
        inputs: subject.inputs,
        drive_log: subject.log.id.to_string(),
        segmentation: subject.segmentation.map(StoredSegmentation::of),
        free_masks: subject.masks.outcomes(),
        tied_masks: Vec::new(),
        background: Vec::new(),
        objects: subject
            .plans
            .iter()
            .map(|plan| LabelledTrack {
                track_id: subject.log.tracks[plan.track].track_id.clone(),
                moving: plan.moving,
                frames: Vec::new(),
            })
            .collect(),
    }
}

fn object_frame<E>(
    log: &DriveLog,
    track: usize,
    loaded: &LoadedFrame,
    write: &mut impl FnMut(&[u8]) -> Result<BlobRef, E>,
) -> Result<ObjectFrame, E> {
    let found = match labelled_object(log, track, loaded) {
        Err(reason) => ObjectPixels::Rejected(reason),
        Ok((crop, labels)) => {
            let size = (crop.width as u32, crop.height as u32);
            ObjectPixels::Kept {
                crop,
                labels: write(&encode_labels(&labels, size))?,
            }
        }
    };
    Ok(ObjectFrame {
        camera_id: loaded.frame.camera_id.clone(),
        frame_index: loaded.frame.frame_index,
        found,
    })
}
