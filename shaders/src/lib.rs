//! WGSL compute kernels of Backlot and what a host must know to run them. Knows no GPU API.
//!
//! `wgsl/` holds libraries (functions only) and one file per entry point. [`kernels`] lists the entry points with their
//! bindings, [`layout`] mirrors the structs. Both are compared with what naga reads from the WGSL, so neither can drift;
//! constants that host and kernel share are pipeline overrides filled from here, so there is no second copy of them.

pub mod layout;

mod kernel;

pub mod kernels;

pub use kernel::{Access, Binding, Kernel};

/// Nodes along one edge of a brick.
pub const BRICK_SIDE: u32 = 8;
