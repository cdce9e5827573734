//! The networks' settings and the log that they see.

use std::collections::BTreeMap;
use std::path::Path;

use backlot_client::read_log::ReadLog;
use backlot_e2e::{logs, painted};
use backlot_server::segment::{ChannelOrder, Layout, RoadUser, RuntimeKind, SegmenterSettings};

/// Inputs of other shapes than the images' 320 x 192, so that padding and scale matter.
const YOLO_INPUT: (u32, u32) = (512, 384);
const MASK_RCNN_INPUT: (u32, u32) = (400, 260);
/// Its road users are painted in colours that the networks find.
pub(super) fn painted_log() -> ReadLog {
    let mut log = logs::small(7);
    painted::paint(&mut log);
    log
}

/// Settings of a network that is written into `folder`.
pub(super) fn settings(folder: &Path, layout: Layout, runtime: RuntimeKind) -> SegmenterSettings {
    let (name, input_px, bytes) = match layout {
        Layout::YoloSeg => ("yolo.onnx", YOLO_INPUT, painted::yolo_seg(YOLO_INPUT)),
        Layout::MaskRcnn => {
            let bytes = painted::mask_rcnn(MASK_RCNN_INPUT);
            ("mask_rcnn.onnx", MASK_RCNN_INPUT, bytes)
        }
    };
    let model = folder.join(name);
    std::fs::write(&model, bytes).unwrap();
    SegmenterSettings {
        model,
        layout,
        input_px,
        classes: BTreeMap::from([(0, RoadUser::Vehicle), (2, RoadUser::Vehicle)]),
        least_score: 0.25,
        most_iou: 0.9,
        channels: ChannelOrder::Rgb,
        mean: [0.0; 3],
        deviation: [1.0; 3],
        runtime,
        library: None,
    }
}
