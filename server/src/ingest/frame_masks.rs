//! What one frame gives of every track and of the background, for people who want to see it.

use backlot_engine::class::ObjectClass;
use backlot_engine::view::PixelLabel;

use super::background_labels::{background_labels, moving_tracks};
use super::content::LogBlobs;
use super::frame::{FrameError, FrameLoader};
use super::matched_masks::MatchedMasks;
use super::object::labelled_object;
use super::object_plan::{assess, outlines};
use crate::domain::drive_log::DriveLog;

/// Labels of a frame's pixels.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameMasks {
    /// Labels to the background, row-major, of the camera's size.
    pub background: Vec<PixelLabel>,
    /// Every track whose cuboid is in front of the camera.
    pub tracks: Vec<SeenTrack>,
}

#[derive(Clone, Debug, PartialEq)]
pub struct SeenTrack {
    /// Index into the log's tracks.
    pub track: usize,
    /// What reconstruction would learn from, or the reason why it would not, as reports name it.
    pub found: Result<ObjectMask, &'static str>,
}

/// Labels of the pixels around an object.
#[derive(Clone, Debug, PartialEq)]
pub struct ObjectMask {
    /// First column and row in the image.
    pub x: usize,
    pub y: usize,
    pub width: usize,
    pub height: usize,
    /// Row-major.
    pub labels: Vec<PixelLabel>,
}

/// What the frame at `index` of the log gives, as decompositions decide it.
///
/// # Errors
/// [`FrameError`] if the frame cannot be loaded.
pub fn frame_masks<B: LogBlobs>(
    log: &DriveLog,
    blobs: &B,
    masks: &MatchedMasks,
    index: usize,
) -> Result<FrameMasks, FrameError<B::Error>> {
    let loaded = FrameLoader::new(log, blobs, Some(masks)).load(index)?;
    let seen = outlines(log, &loaded.frame, &loaded.camera);
    let has_class = |track: usize| log.tracks[track].class != ObjectClass::Other;
    let tracks = seen.iter().filter(|outline| has_class(outline.track));
    let tracks = tracks.map(|outline| {
        let whole = assess(log, &loaded.frame, &loaded.camera, outline, &seen);
        let found = whole.and_then(|_| labelled_object(log, outline.track, &loaded));
        SeenTrack {
            track: outline.track,
            found: found
                .map(|(crop, labels)| ObjectMask {
                    x: crop.x,
                    y: crop.y,
                    width: crop.width,
                    height: crop.height,
                    labels,
                })
                .map_err(|reason| reason.name()),
        }
    });
    Ok(FrameMasks {
        tracks: tracks.collect(),
        background: background_labels(log, &moving_tracks(log), &loaded),
    })
}
