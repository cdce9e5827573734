//! From assets to new labelled scenes.
//!
//! A [`Recording`] says what a background's log saw: cameras, poses and tracked cuboids. The [`ValidRegion`] says where an
//! object may stand in it.

mod random;

mod recording;

mod collision;
mod density;
mod footprint;
mod valid_region;

pub use collision::{Occupied, intersection_area_m2};
pub use density::{DensityField, HALF_TAU};
pub use footprint::{Footprint, GroundPlane};
pub use random::Draws;
pub use recording::{RecordedCamera, RecordedFrame, RecordedTrack, Recording};
pub use valid_region::{Cell, Unsupported, ValidRegion};
