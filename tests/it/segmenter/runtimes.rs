//! Both runtimes find what is painted, and nothing in the wrong order, classes, scale or place.

use std::collections::BTreeMap;

use backlot_client::read_log::ReadLog;
use backlot_e2e::damaged_masks::read_mask;
use backlot_server::segment::{
    ChannelOrder, Layout, RoadUser, RuntimeKind, Segmenter, SegmenterSettings, label_image, open,
};

use super::networks::{painted_log, settings};
use super::score::{Score, image, looked_at, segment};

fn check_runtime(runtime: RuntimeKind) {
    let folder = tempfile::tempdir().unwrap();
    let log = painted_log();
    for layout in [Layout::YoloSeg, Layout::MaskRcnn] {
        let right = settings(folder.path(), layout, runtime);
        let segmenter = open(&right, 2).unwrap();
        let score = Score::of(&log, &*segmenter);
        let (mean, worst) = (score.mean_iou(), score.worst_iou());
        println!(
            "{runtime:?} {layout:?}: {} objects, mean IoU {mean:.3}, worst {worst:.3}",
            score.wanted
        );
        assert!(score.wanted > 8, "{score:?}");
        assert!(score.is_right(), "{score:?}");

        // Broken on purpose: the other channel order, other classes, and numbers of another scale.
        let swapped = SegmenterSettings {
            channels: ChannelOrder::Bgr,
            ..right.clone()
        };
        let classes = SegmenterSettings {
            classes: BTreeMap::from([(0, RoadUser::Vehicle), (1, RoadUser::Vehicle)]),
            ..right.clone()
        };
        let scaled = SegmenterSettings {
            deviation: [0.5; 3],
            ..right.clone()
        };
        for wrong in [swapped, classes, scaled] {
            let other = open(&wrong, 2).unwrap();
            assert_ne!(other.digest(), segmenter.digest(), "{wrong:?}");
            let score = Score::of(&log, &*other);
            assert!(!score.is_right(), "{wrong:?}: {score:?}");
        }
        check_letterbox(&log, &*segmenter);
    }
}

/// Masks laid over the image by one who forgets that it was padded before are not right.
fn check_letterbox(log: &ReadLog, segmenter: &dyn Segmenter) {
    let mut forgotten = Score::default();
    for frame in looked_at(log) {
        let truth = read_mask(log, frame.instance_mask.as_ref().unwrap());
        let image = image(log, frame);
        let (width, height) = image.dimensions();
        let mut taller = image::RgbImage::from_pixel(width, height + 40, image::Rgb([114; 3]));
        image::imageops::replace(&mut taller, &image, 0, 20);
        forgotten.add(&truth, &segment(segmenter, &taller));
    }
    assert!(!forgotten.is_right(), "{forgotten:?}");
}

#[test]
fn tract_finds_what_is_painted() {
    check_runtime(RuntimeKind::Tract);
}

#[test]
#[ignore = "needs the shared library of ONNX Runtime: tests/onnxruntime_ci.sh"]
fn onnxruntime_finds_what_is_painted() {
    check_runtime(RuntimeKind::OnnxRuntime);
}

#[test]
#[ignore = "needs the shared library of ONNX Runtime: tests/onnxruntime_ci.sh"]
fn both_runtimes_agree() {
    let folder = tempfile::tempdir().unwrap();
    let log = painted_log();
    for layout in [Layout::YoloSeg, Layout::MaskRcnn] {
        let of = |runtime| open(&settings(folder.path(), layout, runtime), 2).unwrap();
        let (one, other) = (of(RuntimeKind::OnnxRuntime), of(RuntimeKind::Tract));
        let mut differing = [0, 0];
        for frame in looked_at(&log) {
            let image = image(&log, frame);
            let mut darker = image.clone();
            for value in darker.iter_mut() {
                *value = value.saturating_sub(20);
            }
            let (reference, instances) = label_image(&segment(&*one, &image), image.dimensions());
            for (wrong, image) in [(0, &image), (1, &darker)] {
                let (labels, found) = label_image(&segment(&*other, image), image.dimensions());
                let pairs = reference.iter().zip(&labels);
                differing[wrong] += pairs.filter(|(a, b)| a != b).count();
                assert!(wrong == 1 || instances.len() == found.len(), "{layout:?}");
            }
        }
        let pixels = looked_at(&log).count() * 320 * 192;
        println!("{layout:?}: {} of {pixels} pixels differ", differing[0]);
        assert!(differing[0] * 10_000 < pixels, "{differing:?} of {pixels}");
        assert!(
            differing[1] * 10_000 > pixels,
            "a darker image passes: {differing:?}"
        );
    }
}
