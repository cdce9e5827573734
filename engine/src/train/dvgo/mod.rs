//! The DVGO recipe for a bounded scene: direct optimisation of dense voxel grids in two stages.
//!
//! A coarse stage finds where the scene is, on a grid of density and plain colour over all that the cameras frame. A fine stage
//! then fits density and 12 features on a tight box, from 64^3 nodes to 160^3, coloured by a small network. Every constant is in
//! [`DvgoRecipe`]; the sources are Sun et al., "Direct Voxel Grid Optimization" (CVPR 2022) and its authors' public release.
//! The result is an ordinary [`crate::field::Field`] with one fully stored level.
//!
//! A step goes: [`pixels`] draws rays, [`march`] finds the samples that matter, [`chunk`] colours and composites them and turns the
//! losses around, [`bins`] sorts the samples by brick, and [`adam`] sums and applies every brick's gradients by one owner.

mod adam;
mod bins;
mod chunk;
mod finish;
mod framing;
mod grid;
mod kernels;
mod losses;
mod march;
mod mask;
mod network;
mod pixels;
mod recipe;
mod resample;
mod run;
mod stage;
#[cfg(test)]
mod tests;
mod view_count;

pub use framing::frustum_box;
#[doc(hidden)]
pub use kernels::GridKernels;
pub use recipe::{DvgoRecipe, GridRecipe, StepRecipe};
pub use run::train_dvgo;
