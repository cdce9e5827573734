//! The DVGO recipe for a bounded scene: direct optimisation of dense voxel grids in two stages.
//!
//! A coarse stage finds where the scene is, on a grid of density and plain colour over all that the cameras frame. A fine stage
//! then fits density and 12 features on a tight box, from 64^3 nodes to 160^3, coloured by a small network. Every constant is in
//! [`DvgoRecipe`]; the sources are Sun et al., "Direct Voxel Grid Optimization" (CVPR 2022) and its authors' public release.
//! The result is an ordinary [`crate::field::Field`] with one fully stored level.
//!
//! Steps run on the processor or on a GPU ([`steps`]); what is rare (renewing the mask, rescaling, handing over) is done on the host. On the
//! processor a step goes: [`pixels`] draws rays, [`march`] finds the samples that matter, [`chunk`] colours and composites them and turns the
//! losses around, [`bins`] sorts the samples by brick, and [`adam`] sums and applies every brick's gradients by one owner.

mod adam;
mod bins;
mod chunk;
mod cpu_steps;
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
mod steps;
#[cfg(test)]
pub(crate) mod tests;
mod view_count;

pub use framing::frustum_box;
#[doc(hidden)]
pub use kernels::GridKernels;
pub use recipe::{DvgoRecipe, GridRecipe, StepRecipe};
pub use run::train_dvgo;
#[cfg(all(test, feature = "gpu"))]
pub(crate) use {chunk::record, steps::Steps};

#[cfg(feature = "gpu")]
pub(crate) use {
    adam::{LIVELY_STEPS, bias_correction},
    march::STOP_TAU,
    mask::NodeMask,
    pixels::PixelRay,
    stage::Stage,
};
