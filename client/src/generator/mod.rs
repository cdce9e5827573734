//! Generated driving logs: a procedurally textured street, ray-traced exactly. All of it is synthetic and says so.
//!
//! A [`StreetConfig`] makes a [`StreetWorld`]; its [`read_log`](StreetWorld::read_log) is the input of the demo, and its
//! [`render`](StreetWorld::render) is the ground truth for any view and any object poses. Inside, data flows from `street`, `facade` and
//! `car` (meshes) through `bvh` and `scene` (rays) to `texture`, `road`, `paint`, `sky` and `shade` (light), then `render`, `lidar`, `depth` and `log`.

mod config;

mod noise;

mod mesh;

mod bvh;

mod car;

mod facade;

mod street;

mod actors;

mod scene;

mod sky;

mod texture;

mod road;

mod paint;

mod shade;

mod render;

mod world;

mod lidar;

mod depth;

mod log;

mod warp;

#[cfg(test)]
mod tests;

pub use actors::ActorPose;
pub use config::{DepthRecording, Error, LidarConfig, PoseNoise, StreetConfig};
pub use lidar::LidarPoint;
pub use render::{ExactFrame, RenderOptions, ShadowCasters, View};
pub use warp::{psnr, warp_by_depth};
pub use world::StreetWorld;
