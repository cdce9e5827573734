//! Exact images: any view of the street with cars at any poses.

use backlot_engine::camera::{Camera, Rigid};
use glam::{DVec2, DVec3, Vec3};
use rayon::prelude::*;

use super::bvh::Ray;
use super::scene::{Scene, Target};
use super::shade::{PixelRay, Shaded, develop, encode, shade};

/// A camera and where it is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View {
    pub camera: Camera,
    pub world_from_camera: Rigid,
}

/// Which of the rendered cars cast shadows on other things. Every car shades itself.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum ShadowCasters {
    #[default]
    All,
    None,
    /// One flag for each actor, in order; missing ones are false.
    Flags(Vec<bool>),
}

impl ShadowCasters {
    pub(super) fn includes(&self, index: usize) -> bool {
        match self {
            Self::All => true,
            Self::None => false,
            Self::Flags(flags) => flags.get(index).copied().unwrap_or(false),
        }
    }
}

/// How to render.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RenderOptions {
    /// Samples per side of a pixel where an edge crosses it; 1 turns anti-aliasing off.
    pub supersample: u32,
    pub shadow_casters: ShadowCasters,
}

impl Default for RenderOptions {
    fn default() -> Self {
        Self {
            supersample: 2,
            shadow_casters: ShadowCasters::All,
        }
    }
}

/// An exact image with its ground truth, all row-major. Everything but the colours is taken at pixel centres.
#[derive(Clone, Debug, PartialEq)]
pub struct ExactFrame {
    pub width: u32,
    pub height: u32,
    /// sRGB, three bytes a pixel.
    pub rgb8: Vec<u8>,
    /// Depth along the optical axis in metres; infinite for sky.
    pub depth_z_m: Vec<f32>,
    /// 0 = none, otherwise 1 + index into the rendered actors.
    pub instance: Vec<u16>,
    pub sky: Vec<bool>,
}

/// The first sample of a pixel, at its centre.
struct Centre {
    shaded: Shaded,
    depth_z_m: f32,
    instance: u16,
}

/// Depth steps beyond this part of the expected slope count as edges.
const DEPTH_EDGE: f32 = 0.03;
/// Beyond this depth geometry is finer than pixels everywhere, so every pixel is supersampled.
const FINE_DEPTH_M: f32 = 45.0;

pub(super) fn render(scene: &Scene<'_>, view: &View, supersample: u32, seed: u32) -> ExactFrame {
    let (width, height) = (view.camera.width as usize, view.camera.height as usize);
    let centres: Vec<Centre> = (0..width * height)
        .into_par_iter()
        .with_min_len(width)
        .map(|i| centre(scene, view, i % width, i / width, seed))
        .collect();
    let rgb8 = (0..width * height)
        .into_par_iter()
        .with_min_len(width)
        .flat_map_iter(|i| {
            let (x, y) = (i % width, i / width);
            let linear = if supersample > 1 && on_edge(&centres, width, height, x, y) {
                antialiased(scene, view, x, y, supersample, seed)
            } else {
                develop(centres[i].shaded.radiance)
            };
            encode(linear)
        })
        .collect();
    ExactFrame {
        width: view.camera.width,
        height: view.camera.height,
        rgb8,
        depth_z_m: centres.iter().map(|c| c.depth_z_m).collect(),
        instance: centres.iter().map(|c| c.instance).collect(),
        sky: centres.iter().map(|c| c.depth_z_m.is_infinite()).collect(),
    }
}

/// The ray through a continuous pixel position; its distances are depths along the optical axis.
pub(super) fn pixel_ray(view: &View, pixel: DVec2, pixel_size: f64) -> PixelRay {
    let through = |p: DVec2| {
        let d = view.camera.direction(p);
        view.world_from_camera.direction(d / d.z)
    };
    let direction = through(pixel);
    let right = view
        .world_from_camera
        .direction(DVec3::X * (pixel_size / view.camera.focal_px.x));
    let down = view
        .world_from_camera
        .direction(DVec3::Y * (pixel_size / view.camera.focal_px.y));
    PixelRay {
        ray: Ray {
            origin: view.world_from_camera.translation_m.as_vec3(),
            direction: direction.as_vec3(),
        },
        right: right.as_vec3(),
        down: down.as_vec3(),
    }
}

fn centre(scene: &Scene<'_>, view: &View, x: usize, y: usize, seed: u32) -> Centre {
    let pixel = pixel_ray(view, DVec2::new(x as f64 + 0.5, y as f64 + 0.5), 1.0);
    let hit = scene.nearest(&pixel.ray);
    let instance = match hit.map(|h| h.target) {
        Some(Target::Actor(index, _)) => index as u16 + 1,
        _ => 0,
    };
    Centre {
        shaded: shade(scene, &pixel, hit.as_ref(), seed),
        depth_z_m: hit.map_or(f32::INFINITY, |h| h.t),
        instance,
    }
}

fn on_edge(centres: &[Centre], width: usize, height: usize, x: usize, y: usize) -> bool {
    let at = |x: usize, y: usize| &centres[y * width + x];
    let here = at(x, y);
    if here.depth_z_m.is_finite() && here.depth_z_m > FINE_DEPTH_M {
        return true;
    }
    let neighbours = [
        (x > 0).then(|| at(x - 1, y)),
        (x + 1 < width).then(|| at(x + 1, y)),
        (y > 0).then(|| at(x, y - 1)),
        (y + 1 < height).then(|| at(x, y + 1)),
    ];
    neighbours.into_iter().flatten().any(|other| {
        here.shaded.key != other.shaded.key
            || here.shaded.normal.dot(other.shaded.normal) < 0.9 && here.depth_z_m.is_finite()
            || folded(here, other)
    })
}

/// Whether two neighbouring pixels of one flat material lie on different planes of it.
fn folded(a: &Centre, b: &Centre) -> bool {
    let near = a.depth_z_m.min(b.depth_z_m);
    let ground = a.shaded.normal.z > 0.99;
    !ground && near.is_finite() && (a.depth_z_m - b.depth_z_m).abs() > DEPTH_EDGE * near + 0.15
}

/// Mean of samples that fall into different rows and columns of the pixel, developed first so that bright edges stay smooth.
fn antialiased(
    scene: &Scene<'_>,
    view: &View,
    x: usize,
    y: usize,
    supersample: u32,
    seed: u32,
) -> Vec3 {
    let n = f64::from(supersample);
    let mut sum = Vec3::ZERO;
    for j in 0..supersample {
        for i in 0..supersample {
            let (i, j) = (f64::from(i), f64::from(j));
            let offset = DVec2::new(i + (j + 0.5) / n, j + (n - i - 0.5) / n) / n;
            let pixel = pixel_ray(view, DVec2::new(x as f64, y as f64) + offset, 1.0 / n);
            let hit = scene.nearest(&pixel.ray);
            sum += develop(shade(scene, &pixel, hit.as_ref(), seed).radiance);
        }
    }
    sum / (supersample * supersample) as f32
}
