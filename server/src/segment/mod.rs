//! Road users in images, found by a trained model: where masks come from if a log brings none.
//!
//! A model is an ONNX file that the server's configuration names. What is ours is all but the network itself: how an image becomes its
//! input, and how its outputs become masks of whole pixels. Networks run in ONNX Runtime (cargo feature `onnxruntime`) or in tract
//! (cargo feature `tract`).

mod error;
mod instance;
mod segmenter;

mod settings;

mod letterbox;
mod plane;
mod tensor;

mod detection;
mod mask_rcnn;
mod yolo_seg;

mod model;

#[cfg(feature = "onnxruntime")]
mod onnxruntime;
#[cfg(feature = "tract")]
mod tract;

mod open;

pub use error::SegmentError;
pub use instance::{Instance, InstanceMask, LabelledInstance, RoadUser, label_image};
pub use open::{OpenError, open};
pub use segmenter::{RgbImage, Segmenter};
pub use settings::{ChannelOrder, Layout, RawSegmenter, RuntimeKind, SegmenterSettings};
