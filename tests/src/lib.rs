//! Harness of the end-to-end tests: the real `backlotd` and `backlot` as processes, small generated logs, and what must not change.

pub mod programs;

pub mod server;

pub mod logs;

pub mod damaged_masks;

pub mod mask_score;

pub mod onnx;

pub mod painted;

pub mod state;

pub use programs::{Finished, backlot, backlotd};
pub use server::Server;
