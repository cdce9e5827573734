//! Every rule of the recipe, and the whole of it on a small scene.

mod adam;
mod grids;
mod losses;
mod scene;
mod whole;
