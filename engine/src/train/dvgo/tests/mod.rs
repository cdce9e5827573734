//! Every rule of the recipe, and the whole of it on a small scene.

mod adam;
mod grids;
mod losses;
mod scene;
#[cfg(feature = "gpu")]
pub(crate) mod stages;
pub(crate) mod whole;
