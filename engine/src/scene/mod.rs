//! From assets to new labelled scenes.
//!
//! A [`Recording`] says what a background's log saw: cameras, poses and tracked cuboids.

mod random;
mod recording;

pub use random::Draws;
pub use recording::{RecordedCamera, RecordedFrame, RecordedTrack, Recording};
