//! From assets to new labelled scenes.
//!
//! A [`Recording`] says what a background's log saw: cameras, poses and tracked cuboids. The [`ValidRegion`] says where an
//! object may stand in it. [`compose`] draws a pose and places objects by a [`Recipe`]. [`render`] merges the fields in one
//! volume pass, and [`label`] says what can be seen of each object.

mod random;

mod recording;

mod collision;
mod coverage;
mod density;
mod driven;
mod footprint;
mod ground;
mod path;
mod pillar;
mod region_builder;
mod valid_region;

mod acceptance;
mod arcs;
mod clip;
mod composition;
mod edit;
mod histogram;
mod movement;
mod originals;
mod placement;
mod places;
mod preset;
mod projection;
mod proposal;
mod recipe;
mod rejection;
mod road;
mod sight;
mod target;
mod timeline;
mod trajectory;

mod frame;
mod merge;
mod render;
mod tile;

mod daylight;
mod ground_light;
mod linear;
mod measured_light;
mod relight;
mod shadow;
mod sun_grid;
mod surface;

mod fill;
mod finish;
mod hull;
mod patches;
mod recorded;
mod rows;
mod seen;
mod silhouette;
mod tone;

mod labels;
mod lidar;
mod rle;

#[cfg(test)]
mod box_world;
#[cfg(test)]
mod clip_tests;
#[cfg(test)]
mod composition_tests;
#[cfg(test)]
mod corner_case_tests;
#[cfg(test)]
mod driven_tests;
#[cfg(test)]
mod finish_tests;
#[cfg(test)]
mod label_tests;
#[cfg(test)]
mod placement_tests;
#[cfg(test)]
mod region_tests;
#[cfg(test)]
mod region_trained_tests;
#[cfg(test)]
mod render_tests;
#[cfg(test)]
mod solid_field;
#[cfg(test)]
mod sunlight_tests;
#[cfg(test)]
mod voxel_street;

pub use clip::compose_clip;
pub use collision::{Occupied, intersection_area_m2};
pub use composition::{
    ATTEMPTS, Candidate, Composition, LeftOut, Origin, PlacedObject, Stage, compose,
};
pub use daylight::{Daylight, SunSource};
pub use density::{DensityField, HALF_TAU};
pub use edit::{ActorEdit, Edit, GivenObject, MAX_EDITS, MAX_GIVEN_OBJECTS, Shift};
pub use finish::{Finished, finish};
pub use footprint::{Footprint, GroundPlane};
pub use frame::RenderedFrame;
pub use histogram::Histogram;
pub use labels::{FrameLabel, label};
pub use measured_light::measure_daylight;
pub use merge::{Merged, composite, merge};
pub use pillar::Pillars;
pub use preset::PlacementPreset;
pub use projection::{PixelBox, amodal_box, corners};
pub use random::Draws;
pub use recipe::{ClassShare, Jitter, MAX_OBJECTS, MAX_SIDE_PX, Recipe};
pub use recorded::{InstanceMask, RecordedImage, needs_recorded};
pub use recording::{RecordedCamera, RecordedFrame, RecordedTrack, Recording};
pub use region_builder::RegionConfig;
pub use rejection::Rejection;
pub use relight::{ObjectLight, Relit, object_lights, relight};
#[cfg(feature = "gpu")]
pub(crate) use render::{Prepared, assemble};
pub use render::{RenderOptions, Scene, SceneObject, StaticObject, render};
pub use rle::{column_runs, mask_of_runs};
pub use shadow::{Caster, cast_shadows, shadow_casters};
#[cfg(feature = "gpu")]
pub(crate) use tile::{
    EyeRay, HALF, MIN_WEIGHT, Pixel, STOP_TAU, STOP_TAU_THROUGH_OBJECT, TileResult, crosses, holds,
    owner, touches,
};
pub use timeline::{Clip, MAX_CLIP_FRAMES};
pub use tone::{Tone, match_tones};
pub use trajectory::{MAX_WAYPOINTS, Trajectory, Waypoint};
pub use valid_region::{Cell, NO_GROUND, Unsupported, ValidRegion};
