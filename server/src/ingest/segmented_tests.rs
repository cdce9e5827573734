//! Masks of a segmenter: which frames get them, what they are matched to, and that compositions find them.

use std::collections::BTreeMap;
use std::sync::Mutex;

use super::decompose_tests::{Blobs, street};
use super::image::{decode_instance_mask, decode_rgb};
use super::mask_match::{MaskMatching, MaskOutcome};
use super::segmented::{ClassedMasks, Segmentation, segment_log};
use super::tied_masks::{TiedMask, tie_masks};
use super::{MatchedMasks, match_masks, recording};
use crate::domain::blob::{BlobRef, Digest};
use crate::domain::drive_log::{DriveLog, MASK_UNKNOWN};
use crate::segment::{Instance, InstanceMask, RgbImage, RoadUser, SegmentError, Segmenter};

const SIZE: (u32, u32) = (320, 160);

/// Knows the right masks of every image.
#[derive(Debug)]
struct Knowing {
    masks: BTreeMap<Digest, Vec<u16>>,
    class: RoadUser,
    asked: Mutex<usize>,
}

impl Knowing {
    fn of(log: &DriveLog, blobs: &Blobs, class: RoadUser) -> Self {
        let masks = log.frames.iter().map(|frame| {
            let rgb = decode_rgb(&blobs.content(&frame.image), SIZE).unwrap();
            let mask = blobs.content(&frame.instance_mask.unwrap());
            (Digest::of(&rgb), decode_instance_mask(&mask, SIZE).unwrap())
        });
        Self {
            masks: masks.collect(),
            class,
            asked: Mutex::default(),
        }
    }
}

impl Segmenter for Knowing {
    fn segment(&self, image: RgbImage<'_>) -> Result<Vec<Instance>, SegmentError> {
        *self.asked.lock().unwrap() += 1;
        let mask = &self.masks[&Digest::of(image.pixels)];
        let instance = |value: u16| Instance {
            class: self.class,
            score: 1.0 - f32::from(value) / 100.0,
            mask: InstanceMask {
                x: 0,
                y: 0,
                width: SIZE.0,
                height: SIZE.1,
                pixels: mask.iter().map(|&v| v == value).collect(),
            },
        };
        let present = (1..=3).filter(|value| mask.contains(value));
        Ok(present.map(instance).collect())
    }

    fn digest(&self) -> Digest {
        Digest::of(b"knowing")
    }

    fn name(&self) -> &str {
        "knowing"
    }
}

/// The street without masks, but for its first frame, and what a segmenter of the right masks says of it.
fn segmented(class: RoadUser) -> (DriveLog, Blobs, Segmentation) {
    let (truth, mut blobs) = street(true);
    let segmenter = Knowing::of(&truth, &blobs, class);
    let mut log = truth;
    for frame in &mut log.frames[1..] {
        frame.instance_mask = None;
    }
    let mut written = Vec::new();
    let write = |content: &[u8]| {
        written.push(content.to_vec());
        Ok(BlobRef::of(content))
    };
    let found = segment_log(&log, &blobs, &segmenter, write, |_, _| true);
    let found = found.unwrap().unwrap();
    written.into_iter().for_each(|content| {
        blobs.add(content);
    });
    assert_eq!(*segmenter.asked.lock().unwrap(), log.frames.len() - 1);
    (log, blobs, found)
}

fn matched(log: &DriveLog, blobs: &Blobs, found: &Segmentation) -> MatchedMasks {
    let source = ClassedMasks {
        blobs,
        segmentation: Some(found),
    };
    let matching = MaskMatching::default();
    let masks = match_masks(log, blobs, &source, &matching, |_, _| true);
    masks.unwrap().unwrap()
}

#[test]
fn masks_are_matched_within_their_class() {
    let (log, blobs, found) = segmented(RoadUser::Vehicle);
    let instances: usize = found.frames.values().map(|f| f.instances.len()).sum();
    assert!(instances > 20 && found.summary().contains(&instances.to_string()));
    let log_with_masks = found.over(log.clone());
    assert!(log_with_masks.frames[0].free_instance_mask.is_none());
    let counts = matched(&log_with_masks, &blobs, &found).counts();
    let as_count = |count: usize| u32::try_from(count).unwrap();
    assert!(counts[&MaskOutcome::Matched] > 15, "{counts:?}");
    assert_eq!(counts.values().sum::<u32>(), as_count(instances));

    let (log, blobs, found) = segmented(RoadUser::Pedestrian);
    let counts = matched(&found.over(log.clone()), &blobs, &found).counts();
    assert!(!counts.contains_key(&MaskOutcome::Matched), "{counts:?}");
    assert!(counts[&MaskOutcome::OtherClass] > 15, "{counts:?}");
}

#[test]
fn segmenting_stops_between_two_images() {
    let (truth, blobs) = street(true);
    let segmenter = Knowing::of(&truth, &blobs, RoadUser::Vehicle);
    let mut log = truth;
    for frame in &mut log.frames {
        frame.instance_mask = None;
    }
    let write = |content: &[u8]| Ok(BlobRef::of(content));
    let found = segment_log(&log, &blobs, &segmenter, write, |done, _| done < 3);
    assert!(found.unwrap().is_none());
    assert_eq!(*segmenter.asked.lock().unwrap(), 3);
}

#[test]
fn compositions_find_the_masks_that_were_tied() {
    let (log, mut blobs, found) = segmented(RoadUser::Vehicle);
    let (truth, truth_blobs) = street(true);
    let log = found.over(log.clone());
    let masks = matched(&log, &blobs, &found);
    let mut written = Vec::new();
    let write = |content: &[u8]| {
        written.push(content.to_vec());
        Ok(BlobRef::of(content))
    };
    let tied = tie_masks(&log, &blobs, &masks, write, |_, _| true);
    let tied: Vec<TiedMask> = tied.unwrap().unwrap();
    written.into_iter().for_each(|content| {
        blobs.add(content);
    });
    assert_eq!(tied.len(), log.frames.len() - 1);
    let mut right = 0;
    for mask in &tied {
        let values = decode_instance_mask(&blobs.content(&mask.mask), SIZE).unwrap();
        let frame = &truth.frames[mask.frame_index as usize];
        let known = truth_blobs.content(&frame.instance_mask.unwrap());
        let known = decode_instance_mask(&known, SIZE).unwrap();
        for (value, known) in values.into_iter().zip(known) {
            assert!(value == known || (value == MASK_UNKNOWN && known != 0));
            right += usize::from(value == known && known != 0);
        }
    }
    assert!(right > 10_000, "{right} pixels of tracks");

    let digests = |tied: &[TiedMask]| -> Vec<Option<String>> {
        let frames = recording(&log, tied).frames;
        frames.into_iter().map(|f| f.instance_mask).collect()
    };
    let with = digests(&tied);
    assert_eq!(
        with[0],
        log.frames[0].instance_mask.map(|m| m.digest.to_string())
    );
    assert_eq!(with[4], Some(tied[3].mask.digest.to_string()));
    assert!(digests(&[])[1..].iter().all(Option::is_none));
}
