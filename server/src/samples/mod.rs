//! From a recipe or an explicit scene to encoded, labelled samples. Everything here blocks; none of it runs on a tokio worker.

mod error;

mod cache;
mod encode;
mod library;

mod plan;
mod recipe_samples;
mod sample;
mod scene_sample;

pub use cache::AssetCache;
pub use error::{Error, Result};
pub use plan::SamplePlan;
pub use recipe_samples::{Planes, RecipeRequest, RecipeSamples};
pub use sample::{DEPTH_UNIT_M, Sample, SampleBox, SampleFrame, SampleObject};
pub use scene_sample::{SceneObjectRequest, SceneRequest, render_scene};
