//! A rendered image, kept as two layers until it is finished: the placed objects, and what lies behind them.

use std::collections::BTreeMap;

use glam::{DVec2, DVec3};

use super::render::Scene;

/// A rendered image with its geometry; everything row-major, `height * width`.
///
/// `rgb8 = placed_rgb + (1 - placed_alpha) * behind_rgb`, so that what lies behind can still be replaced or shaded without a rim
/// of the old colour around the objects.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RenderedFrame {
    pub width: u32,
    pub height: u32,
    /// sRGB, three bytes a pixel.
    pub rgb8: Vec<u8>,
    /// Camera z in metres of the surface at which half of the light is gone; 0 where more than half is left.
    pub depth_z_m: Vec<f32>,
    /// Instance of each pixel, 0 for background and sky. An inserted object owns a pixel if all inserted objects together carry at
    /// least half of its weight and it carries most of theirs; a static one if the pixel's surface lies in its cuboid.
    pub instance: Vec<u16>,
    /// 1 - transmittance of everything but the sky.
    pub accumulation: Vec<f32>,
    /// sRGB of background and sky, 0..=1; black where placed objects hide all of it.
    pub behind_rgb: Vec<[f32; 3]>,
    /// [`Self::depth_z_m`] of the background alone.
    pub behind_z_m: Vec<f32>,
    /// sRGB of the placed objects times their weight.
    pub placed_rgb: Vec<[f32; 3]>,
    /// Weight of the placed objects, 0..=1.
    pub placed_alpha: Vec<f32>,
    /// (instance id, pixels it would have alone in the scene) in the scene's order: objects, then statics.
    pub alone_px: Vec<(u16, u32)>,
    /// Pixels an object would have alone, by (object, instance that owns them instead; 0 for the background).
    pub hidden_px: BTreeMap<(u16, u16), u32>,
}

/// With less left of it, what lies behind cannot be told from the objects before it.
const LEAST_BEHIND: f32 = 1e-3;

impl RenderedFrame {
    pub(super) fn empty(width: u32, height: u32) -> Self {
        let count = width as usize * height as usize;
        Self {
            width,
            height,
            rgb8: vec![0; 3 * count],
            depth_z_m: vec![0.0; count],
            instance: vec![0; count],
            accumulation: vec![0.0; count],
            behind_rgb: vec![[0.0; 3]; count],
            behind_z_m: vec![0.0; count],
            placed_rgb: vec![[0.0; 3]; count],
            placed_alpha: vec![0.0; count],
            alone_px: Vec::new(),
            hidden_px: BTreeMap::new(),
        }
    }

    /// Sets both layers of a pixel; `behind` is weighted as it was composited.
    pub(super) fn set_layers(&mut self, i: usize, behind: [f32; 3], placed: [f32; 3], alpha: f32) {
        let left = 1.0 - alpha;
        self.placed_rgb[i] = placed;
        self.placed_alpha[i] = alpha;
        self.behind_rgb[i] = match left > LEAST_BEHIND {
            true => behind.map(|c| c / left),
            false => [0.0; 3],
        };
        self.flatten(i);
    }

    /// Replaces what lies behind the placed objects.
    pub(super) fn set_behind(&mut self, i: usize, rgb: [f32; 3]) {
        self.behind_rgb[i] = rgb;
        self.flatten(i);
    }

    /// Replaces the placed objects' colours, which come times their weight.
    pub(super) fn set_placed(&mut self, i: usize, rgb: [f32; 3]) {
        self.placed_rgb[i] = rgb;
        self.flatten(i);
    }

    /// Whether enough of what lies behind shows to know its colour.
    pub(super) fn shows_behind(&self, i: usize) -> bool {
        1.0 - self.placed_alpha[i] > LEAST_BEHIND
    }

    fn flatten(&mut self, i: usize) {
        let left = 1.0 - self.placed_alpha[i];
        for c in 0..3 {
            let value = self.placed_rgb[i][c] + left * self.behind_rgb[i][c];
            self.rgb8[3 * i + c] = to_byte(value);
        }
    }

    pub(super) fn pixel_centre(&self, i: usize) -> DVec2 {
        let width = self.width as usize;
        DVec2::new((i % width) as f64 + 0.5, (i / width) as f64 + 0.5)
    }

    /// The local point of pixel `i` at camera z `z_m`.
    pub(super) fn point(&self, scene: &Scene<'_>, i: usize, z_m: f64) -> DVec3 {
        let direction = scene.camera.direction(self.pixel_centre(i));
        scene
            .local_from_camera
            .point(direction * (z_m / direction.z))
    }
}

fn to_byte(value: f32) -> u8 {
    (value.clamp(0.0, 1.0) * 255.0).round() as u8
}
