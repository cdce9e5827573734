//! Labels that are stored and read give the training sets that labels made on the spot give.

use backlot_engine::view::{PixelLabel, TrainView};

use super::decompose_tests::{Blobs, matched, street, untie};
use super::decomposition::{Decomposition, ObjectFrame, ObjectPixels, encode_labels};
use super::log_labels::{LogLabels, StoredLabels};
use super::{Subject, background_set, decompose, object_set, plan_objects};
use crate::domain::blob::{BlobRef, Digest};
use crate::domain::drive_log::DriveLog;

/// A decomposition of the street with its label images among the blobs.
fn decomposed(log: &DriveLog, blobs: &mut Blobs) -> Decomposition {
    let masks = matched(log, blobs);
    let subject = Subject {
        log,
        segmentation: None,
        masks: &masks,
        plans: &plan_objects(log),
        inputs: Digest::of(b"inputs"),
    };
    let mut written = Vec::new();
    let write = |content: &[u8]| {
        written.push(content.to_vec());
        Ok(BlobRef::of(content))
    };
    let made = decompose(&subject, blobs, write, |_, _| true).unwrap();
    written.into_iter().for_each(|content| {
        blobs.add(content);
    });
    made.unwrap()
}

fn same_views(a: &[TrainView], b: &[TrainView]) -> bool {
    let same = |(a, b): (&TrainView, &TrainView)| {
        a.frame_index == b.frame_index
            && a.labels == b.labels
            && a.rgb == b.rgb
            && a.depth == b.depth
            && a.split == b.split
    };
    a.len() == b.len() && a.iter().zip(b).all(same)
}

#[test]
fn a_stored_decomposition_gives_the_same_training_sets() {
    for (with_masks, free) in [(true, false), (false, false), (true, true)] {
        let (mut log, mut blobs) = street(with_masks);
        if free {
            untie(&mut log, &mut blobs);
        }
        let made = LogLabels::Made(matched(&log, &blobs));
        let decomposition = decomposed(&log, &mut blobs);
        let stored = LogLabels::Stored(StoredLabels::new(&decomposition));
        let background = |labels: &LogLabels, blobs: &Blobs| {
            let set = background_set(&log, blobs, labels, 8, 800, |_, _| true);
            set.unwrap().unwrap().input
        };
        let (first, second) = (background(&made, &blobs), background(&stored, &blobs));
        assert!(same_views(&first.views, &second.views));
        assert_eq!(first.lidar_points, second.lidar_points);
        for plan in plan_objects(&log) {
            let set = |labels: &LogLabels| {
                let set = object_set(&log, &blobs, labels, &plan, 8, |_, _| true);
                set.unwrap().unwrap()
            };
            let (first, second) = (set(&made), set(&stored));
            assert_eq!(first.rejected, second.rejected);
            assert!(same_views(&first.input.views, &second.input.views));
            assert_eq!(first.input.lidar_points, second.input.lidar_points);
        }
        // Another label image makes another training set.
        let mut broken = decomposition.clone();
        let other = encode_labels(&[PixelLabel::Unknown; 320 * 160], (320, 160));
        broken.background[5].labels = blobs.add(other);
        let broken = LogLabels::Stored(StoredLabels::new(&broken));
        assert!(!same_views(
            &first.views,
            &background(&broken, &blobs).views
        ));
    }
}

#[test]
fn a_decomposition_without_a_frame_or_an_image_is_an_error_that_names_it() {
    let (log, mut blobs) = street(true);
    let whole = decomposed(&log, &mut blobs);
    let fails = |decomposition: &Decomposition, blobs: &Blobs| {
        let labels = LogLabels::Stored(StoredLabels::new(decomposition));
        let set = background_set(&log, blobs, &labels, 8, 800, |_, _| true);
        set.err().map(|error| error.to_string())
    };
    assert_eq!(fails(&whole, &blobs), None);
    let mut lacking = whole.clone();
    lacking.background.remove(3);
    let error = fails(&lacking, &blobs).expect("frame 3 is missing");
    assert!(error.contains("frame 3"), "{error}");
    let mut other = whole.clone();
    other.background[3].labels = log.frames[3].image;
    let error = fails(&other, &blobs).expect("a photograph is no label image");
    assert!(error.contains("frame 3: label image"), "{error}");
    let kept = |frames: &[ObjectFrame]| {
        let is_kept = |f: &&ObjectFrame| matches!(f.found, ObjectPixels::Kept { .. });
        frames.iter().filter(is_kept).count()
    };
    assert!(whole.objects.iter().any(|track| kept(&track.frames) >= 8));
}
