//! The free masks of a whole log, matched to its tracks.

use std::collections::BTreeMap;

use backlot_engine::camera::Camera;

use super::background::time_order;
use super::content::LogBlobs;
use super::frame::{FrameError, FrameLoader};
use super::free_masks::MaskSource;
use super::mask_consistency::{Consistency, Doubt, Doubted, ScaledMask};
use super::mask_match::{Evidence, FrameMatch, MaskMatching, MaskOutcome, match_frame};
use super::mask_overlap::Overlaps;
use super::mask_returns::{MaskReturns, MaskedImage};
use super::object_plan::{Rejection, outlines};
use super::projected::project_returns;
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
pub fn match_masks<B: LogBlobs, S: MaskSource<Error = B::Error>>(
    log: &DriveLog,
    blobs: &B,
    source: &S,
    matching: &MaskMatching,
    mut progress: impl FnMut(usize, usize) -> bool,
) -> Result<Option<MatchedMasks>, FrameError<B::Error>> {
    let mut matched = MatchedMasks::default();
    let mut matcher = Matcher {
        log,
        source,
        matching,
        loader: FrameLoader::new(log, blobs, None),
        consistency: Consistency::new(matching),
    };
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
        let found = matcher.frame(index, &camera.camera, &free)?;
        matched.frames.insert(index, found);
    }
    for doubted in matcher.consistency.finish() {
        matched.reject(doubted);
    }
    Ok(Some(matched))
}

struct Matcher<'a, B, S> {
    log: &'a DriveLog,
    source: &'a S,
    matching: &'a MaskMatching,
    loader: FrameLoader<'a, B>,
    consistency: Consistency<'a>,
}

impl<B: LogBlobs, S: MaskSource<Error = B::Error>> Matcher<'_, B, S> {
    /// The frame at an index of the log, whose free masks are `free`.
    fn frame(
        &mut self,
        index: usize,
        camera: &Camera,
        free: &[u16],
    ) -> Result<FrameMatch, FrameError<B::Error>> {
        let frame = &self.log.frames[index];
        let tracks = &self.log.tracks;
        self.loader.read_sweeps(frame)?;
        let seen = outlines(self.log, frame, camera);
        let overlaps = Overlaps::of(free, (camera.width, camera.height), &seen);
        let image = MaskedImage {
            camera,
            free,
            masks: &overlaps.masks,
            outlines: &seen,
            tracks,
        };
        let placed = self.loader.sweeps().iter().flat_map(|(_, placed)| placed);
        let placed: Vec<_> = placed.copied().collect();
        let returns = self.log.world_from_camera(frame).map(|pose| {
            let returns = project_returns(&placed, tracks, camera, &pose, frame.timestamp_ns);
            MaskReturns::of(&image, &pose.inverse(), &returns)
        });
        let returns = returns.unwrap_or_default();
        let evidence = Evidence {
            may_be: |mask: u16, track: usize| {
                let class = self.source.class_of(index, mask);
                class.is_none_or(|class| class.may_be(tracks[track].class))
            },
            share_of_others: |mask, own| returns.share_of_others(&image, (mask, own)),
        };
        let found = match_frame(&overlaps, &seen, self.matching, &evidence);
        for (&value, &track) in &found.track_of {
            let own = seen.iter().position(|outline| outline.track == track);
            let own = own.expect("a track was matched through its outline");
            let scaled = ScaledMask::new(&image, value, &overlaps, own);
            let at = (index, frame.timestamp_ns);
            self.consistency.follow(&frame.camera_id, track, at, scaled);
        }
        Ok(found)
    }
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

    fn reject(&mut self, doubted: Doubted) {
        let (outcome, rejection) = match doubted.doubt {
            Doubt::Inconsistent => (MaskOutcome::Inconsistent, Rejection::InconsistentMask),
            Doubt::Grown => (MaskOutcome::Merged, Rejection::MergedMask),
        };
        let found = self.frames.get_mut(&doubted.frame);
        let found = found.expect("it was matched");
        let masks = found.track_of.extract_if(.., |_, t| *t == doubted.track);
        for (value, _) in masks {
            found.outcomes.insert(value, outcome);
        }
        found.unmasked.insert(doubted.track, rejection);
    }
}
