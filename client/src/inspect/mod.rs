//! What a reader understood of a log, in figures and in pictures, before anything is uploaded.

mod depth;

mod report;

mod overlay;

mod masks;

pub use depth::DepthReport;
pub use masks::MaskPictures;
pub use overlay::{overlay, overlay_frames};
pub use report::{CameraReport, LidarReport, LogReport, TrackReport};
