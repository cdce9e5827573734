//! From an uploaded log to what a field is trained on: validation on arrival, then decomposition by workers.

mod violations;

mod hull;
mod image;
mod movers;
mod points;
mod raster;

mod free_masks;

mod arrived_images;
mod content;
mod validate;
#[cfg(test)]
mod validate_tests;

mod lidar;
mod projected;

mod depth_map;
mod sfm;

mod frame;
mod held_out;
mod sky;

mod segmented;

mod beams;
mod between;
mod seeds;

mod mask_consistency;
mod mask_match;
mod mask_overlap;
mod mask_returns;
mod matched_masks;
mod tied_masks;

mod background;
mod background_labels;

mod object;
mod object_labels;
mod object_plan;

mod frame_masks;

mod decompose;
mod decomposition;
mod log_labels;

#[cfg(test)]
mod between_tests;
#[cfg(test)]
mod decompose_tests;
#[cfg(test)]
mod segmented_tests;
#[cfg(test)]
mod stored_labels_tests;

pub(crate) use arrived_images::ArrivedImages;
pub(crate) use background::recording;
pub use background::{BackgroundSet, background_set};
pub use content::LogBlobs;
pub(crate) use decompose::{Subject, decompose};
pub(crate) use decomposition::{
    DECOMPOSITION_VERSION, Decomposition, DecompositionInputs, LabelledTrack, ObjectPixels,
};
pub use frame::FrameError;
pub use frame_masks::{FrameMasks, ObjectMask, SeenTrack, frame_masks};
pub use free_masks::{LogMasks, MaskSource};
pub use image::ImageError;
pub(crate) use image::{decode_instance_mask, decode_rgb};
pub use log_labels::{LogLabels, StoredLabels};
pub use mask_match::{MaskMatching, MaskOutcome};
pub use matched_masks::{MatchedMasks, match_masks};
pub use object::{ObjectSet, object_set};
pub use object_plan::{Rejection, Rejections, TrackPlan, plan_objects};
pub(crate) use segmented::{ClassedMasks, Segmentation, segment_log};
pub(crate) use tied_masks::{TiedMask, tie_masks};
pub use validate::{Accepted, validate};
pub use violations::{FieldViolation, Violations};
