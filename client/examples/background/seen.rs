//! Which pixels of the held-out frames show a surface that some training frame shows too: exact depth decides it, not the field.

use std::collections::HashMap;

use anyhow::Result;
use backlot_client::generator::{ExactFrame, StreetWorld, View};
use backlot_engine::view::{Split, TrainView};
use glam::DVec2;
use rayon::prelude::*;

/// A surface is the one in a frame if its depth lies between those of the four pixels around it, give or take this part.
const DEPTH_SLACK: f64 = 0.02;

/// For each held-out frame, by its index, whether the surface of each pixel is in view in a training frame.
pub(crate) fn seen_pixels(
    world: &StreetWorld,
    views: &[TrainView],
) -> Result<HashMap<u32, Vec<bool>>> {
    let times_ns = world.frame_timestamps_ns();
    let exact = |view: &TrainView| -> Result<(View, ExactFrame)> {
        let time_ns = times_ns[view.frame_index as usize];
        Ok((world.view_at(time_ns), world.frame_at(time_ns)?))
    };
    let of = |split: Split| views.iter().filter(move |view| view.split == split);
    let trained: Vec<_> = of(Split::Train).map(&exact).collect::<Result<_>>()?;
    let mut seen = HashMap::new();
    for view in of(Split::HeldOut) {
        let (from, frame) = exact(view)?;
        let pixels = (0..frame.depth_z_m.len()).into_par_iter().map(|at| {
            let pixel = from.camera.pixel_centre(at);
            let direction = from.camera.direction(pixel);
            let depth_z_m = f64::from(frame.depth_z_m[at]);
            let p_world = from
                .world_from_camera
                .point(direction / direction.z * depth_z_m);
            trained
                .iter()
                .any(|(view, frame)| shows(view, frame, p_world))
        });
        seen.insert(view.frame_index, pixels.collect());
    }
    Ok(seen)
}

fn shows(view: &View, frame: &ExactFrame, p_world: glam::DVec3) -> bool {
    let p_camera = view.world_from_camera.inverse().point(p_world);
    let Some(pixel) = view.camera.project(p_camera) else {
        return false;
    };
    let corner = pixel - DVec2::splat(0.5);
    let (x, y) = (corner.x.floor(), corner.y.floor());
    let (width, height) = (frame.width as usize, frame.height as usize);
    if !(x >= 0.0 && y >= 0.0 && x + 1.0 < width as f64 && y + 1.0 < height as f64) {
        return false;
    }
    let first = y as usize * width + x as usize;
    let depths = [first, first + 1, first + width, first + width + 1];
    let depths = depths.map(|at| f64::from(frame.depth_z_m[at]));
    let near = depths.into_iter().fold(f64::INFINITY, f64::min);
    let far = depths.into_iter().fold(0.0, f64::max);
    p_camera.z >= near * (1.0 - DEPTH_SLACK) && p_camera.z <= far * (1.0 + DEPTH_SLACK)
}
