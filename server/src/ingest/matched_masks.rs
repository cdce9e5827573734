//! The free masks of a whole log, matched to its tracks.

use std::collections::BTreeMap;

use super::background::time_order;
use super::frame::FrameError;
use super::free_masks::MaskSource;
use super::mask_consistency::{Consistency, ScaledMask};
use super::mask_match::{FrameMatch, MaskMatching, MaskOutcome, match_frame};
use super::mask_overlap::Overlaps;
use super::object_plan::{Outline, Rejection, outlines};
use crate::domain::drive_log::{DriveLog, MASK_NONE, MASK_UNKNOWN};

/// Which track each free mask of each frame shows. Empty for logs that bring none.
#[derive(Clone, Debug, Default)]
pub struct MatchedMasks {
    /// By index into the log's frames; frames without free masks are absent.
    frames: BTreeMap<usize, FrameMatch>,
    nothing: BTreeMap<usize, Rejection>,
}

/// Matches every frame's free masks to the tracks, then rejects those that do not agree with the same track's masks in the frames
/// beside them. `progress` hears (frames done, frames) and says whether to go on.
///
/// # Errors
/// [`FrameError`] of the first frame that cannot be read. `Ok(None)` if `progress` said stop.
pub fn match_masks<S: MaskSource>(
    log: &DriveLog,
    source: &S,
    matching: &MaskMatching,
    mut progress: impl FnMut(usize, usize) -> bool,
) -> Result<Option<MatchedMasks>, FrameError<S::Error>> {
    let mut matched = MatchedMasks::default();
    let mut consistency = Consistency::new(matching.least_follow_iou);
    let order = time_order(log);
    for (done, &index) in order.iter().enumerate() {
        let frame = &log.frames[index];
        let Some(camera) = log.camera(&frame.camera_id) else {
            continue;
        };
        // A frame whose masks name their tracks needs no others.
        if frame.instance_mask.is_some() {
            continue;
        }
        let Some(free) = source.free_masks(frame, &camera.camera)? else {
            continue;
        };
        if !progress(done, order.len()) {
            return Ok(None);
        }
        let size = (camera.camera.width, camera.camera.height);
        let seen = outlines(log, frame, &camera.camera);
        let overlaps = Overlaps::of(&free, size, &seen);
        let may_be = |mask: u16, track: usize| {
            let class = source.class_of(index, mask);
            class.is_none_or(|class| class.may_be(log.tracks[track].class))
        };
        let found = match_frame(&overlaps, &seen, matching, may_be);
        for (&value, &track) in &found.track_of {
            let own = own_outline(&seen, track);
            let scaled = ScaledMask::new(&free, size, value, &overlaps, own);
            let at = (index, frame.timestamp_ns);
            consistency.follow(&frame.camera_id, track, at, scaled);
        }
        matched.frames.insert(index, found);
    }
    for (frame, track) in consistency.finish() {
        matched.reject(frame, track);
    }
    Ok(Some(matched))
}

fn own_outline(seen: &[Outline], track: usize) -> (usize, &Outline) {
    let own = |(_, outline): &(usize, &Outline)| outline.track == track;
    let found = seen.iter().enumerate().find(own);
    found.expect("a track was matched through its outline")
}

impl MatchedMasks {
    /// The track that a free mask of a frame shows; `None` if it was refused.
    pub fn track_of(&self, frame: usize, mask: u16) -> Option<usize> {
        self.frames.get(&frame)?.track_of.get(&mask).copied()
    }

    /// How many masks met each outcome.
    pub fn counts(&self) -> BTreeMap<MaskOutcome, u32> {
        let mut counts = BTreeMap::new();
        for outcome in self.frames.values().flat_map(|f| f.outcomes.values()) {
            *counts.entry(*outcome).or_default() += 1;
        }
        counts
    }

    /// [`Self::counts`] by name, as reports have them.
    pub(crate) fn outcomes(&self) -> BTreeMap<String, u32> {
        let counts = self.counts().into_iter();
        counts
            .map(|(outcome, count)| (outcome.name().to_owned(), count))
            .collect()
    }

    /// Free masks as masks tied to tracks; pixels of refused ones become [`MASK_UNKNOWN`].
    pub(super) fn tie(&self, frame: usize, mut free: Vec<u16>) -> Vec<u16> {
        let found = self.frames.get(&frame);
        for run in free.chunk_by_mut(|a, b| a == b) {
            let value = run[0];
            if value != MASK_NONE {
                let track = found.and_then(|f| f.track_of.get(&value));
                run.fill(track.map_or(MASK_UNKNOWN, |track| *track as u16 + 1));
            }
        }
        free
    }

    /// Tracks in the frame that have no mask of their own though masks were brought, and why.
    pub(super) fn unmasked(&self, frame: usize) -> &BTreeMap<usize, Rejection> {
        self.frames
            .get(&frame)
            .map_or(&self.nothing, |f| &f.unmasked)
    }

    fn reject(&mut self, frame: usize, track: usize) {
        let found = self.frames.get_mut(&frame).expect("it was matched");
        let masks = found.track_of.extract_if(.., |_, t| *t == track);
        for (value, _) in masks {
            found.outcomes.insert(value, MaskOutcome::Inconsistent);
        }
        found.unmasked.insert(track, Rejection::InconsistentMask);
    }
}
