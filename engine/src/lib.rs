//! The radiance-field engine: training fields from posed images, composing them and rendering labelled scenes.
//!
//! Reading order follows the data: a `camera` makes rays, a `field` answers density and colour along them, `volume`
//! composites and differentiates, `train` fits a field to views, `scene` places fields together and renders samples.
//! The engine sees one local metric frame in f32; f64 world coordinates stay outside. It knows no tokio, tonic or sled.

pub mod error;

pub mod camera;

pub mod view;

pub mod class;

pub mod field;

pub mod volume;

pub mod backend;

pub mod train;

pub mod quality;

pub mod asset;

pub mod scene;

pub use asset::{Asset, AssetHeader};
pub use class::ObjectClass;
pub use error::{Error, ErrorKind, Result};
pub use field::Field;
