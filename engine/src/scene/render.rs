//! Renders a scene in one volume pass: background, objects and sky on common samples.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use glam::{DVec2, DVec3, Vec3};
use rayon::prelude::*;

use super::composition::{Composition, Origin};
use super::frame::RenderedFrame;
use super::projection::{PixelBox, box_of_corners};
use super::tile::{EyeRay, TILE_PX, TileRenderer, TileResult};
use super::tone::Tone;
use crate::camera::{Camera, Rigid};
use crate::field::Field;
use crate::{Error, Result};

/// Fields placed together, seen by one camera. Frames: the background's local frame and the objects' cuboid frames.
#[derive(Debug)]
pub struct Scene<'a> {
    /// `None` renders objects over transparent black.
    pub background: Option<&'a Arc<Field>>,
    pub objects: Vec<SceneObject<'a>>,
    /// Objects that are part of the background: their pixels are found by depth.
    pub statics: Vec<StaticObject>,
    pub camera: Camera,
    pub local_from_camera: Rigid,
}

/// A field placed in a scene.
#[derive(Clone, Copy, Debug)]
pub struct SceneObject<'a> {
    pub instance_id: u16,
    pub field: &'a Arc<Field>,
    pub local_from_object: Rigid,
    /// Extents of the annotated cuboid in metres.
    pub size_m: DVec3,
    pub tone: Tone,
}

/// A cuboid of the background.
#[derive(Clone, Copy, Debug)]
pub struct StaticObject {
    pub instance_id: u16,
    pub local_from_object: Rigid,
    pub size_m: DVec3,
}

impl<'a> Scene<'a> {
    /// The scene of a composition. `field` gives the field of a library index.
    ///
    /// # Errors
    /// [`Error::Invalid`] if `field` lacks one of the objects.
    pub fn of_composition(
        background: &'a Arc<Field>,
        composition: &Composition,
        field: impl Fn(usize) -> Option<&'a Arc<Field>>,
    ) -> Result<Self> {
        let mut scene = Self {
            background: Some(background),
            objects: Vec::new(),
            statics: Vec::new(),
            camera: composition.camera,
            local_from_camera: composition.local_from_camera,
        };
        for object in &composition.objects {
            match object.asset {
                // Put over the rendered frame by `show_recorded`.
                None if object.origin == Origin::Recorded => {}
                Some(asset) => scene.objects.push(SceneObject {
                    instance_id: object.instance_id,
                    field: field(asset)
                        .ok_or_else(|| Error::invalid(format!("asset {asset} is not loaded")))?,
                    local_from_object: object.local_from_object,
                    size_m: object.size_m,
                    tone: Tone::IDENTITY,
                }),
                None => {
                    assert_eq!(object.origin, Origin::Static, "only statics have no asset");
                    scene.statics.push(StaticObject {
                        instance_id: object.instance_id,
                        local_from_object: object.local_from_object,
                        size_m: object.size_m,
                    });
                }
            }
        }
        Ok(scene)
    }

    /// Gives the named instances their tones.
    pub fn set_tones(&mut self, tones: &[(u16, Tone)]) {
        for object in &mut self.objects {
            let own = tones.iter().find(|(id, _)| *id == object.instance_id);
            object.tone = own.map_or(object.tone, |(_, tone)| *tone);
        }
    }
}

/// How a scene is rendered.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RenderOptions {
    /// Rays per pixel side everywhere.
    pub supersample: u32,
    /// Rays per pixel side, at most, where an object may be whose voxels are smaller than a pixel: as many as bring rays a voxel
    /// apart, and at least two. Other pixels take `supersample`.
    pub object_supersample: u32,
}

impl Default for RenderOptions {
    fn default() -> Self {
        Self {
            supersample: 1,
            // A car with voxels of 0.05 m up to 140 m away at 700 px focal length.
            object_supersample: 4,
        }
    }
}

/// Renders a scene on rayon's threads.
///
/// The result does not depend on the order of `scene.objects` and is equal for equal builds and instruction sets.
///
/// # Errors
/// [`Error::Cancelled`] once `cancelled` says so (asked per tile); [`Error::Invalid`] for a bad camera or pose.
pub fn render(
    scene: &Scene<'_>,
    options: &RenderOptions,
    cancelled: &(dyn Fn() -> bool + Sync),
) -> Result<RenderedFrame> {
    let prepared = Prepared::checked(scene, options)?;
    let (width, height) = (scene.camera.width, scene.camera.height);
    let (columns, rows) = (width.div_ceil(TILE_PX), height.div_ceil(TILE_PX));
    let stop = AtomicBool::new(false);
    let tiles: Vec<TileResult> = (0..columns * rows)
        .into_par_iter()
        .map_init(
            || TileRenderer::new(&prepared),
            |renderer, tile| {
                if stop.load(Ordering::Relaxed) || cancelled() {
                    stop.store(true, Ordering::Relaxed);
                    return TileResult::default();
                }
                renderer.render(tile % columns * TILE_PX, tile / columns * TILE_PX)
            },
        )
        .collect();
    if stop.into_inner() {
        return Err(Error::Cancelled);
    }
    Ok(assemble(&prepared, tiles))
}

fn check_poses(scene: &Scene<'_>) -> Result<()> {
    let poses = scene.objects.iter().map(|o| &o.local_from_object);
    let statics = scene.statics.iter().map(|o| &o.local_from_object);
    let finite = poses
        .chain(statics)
        .chain([&scene.local_from_camera])
        .all(Rigid::is_finite);
    if finite {
        Ok(())
    } else {
        Err(Error::invalid("scene: a pose is not finite"))
    }
}

/// A scene with what every ray needs worked out once.
pub(crate) struct Prepared<'a> {
    pub(crate) background: Option<&'a Arc<Field>>,
    /// Nearest first, so that the caller's order cannot matter.
    pub(crate) objects: Vec<PreparedObject<'a>>,
    pub(crate) statics: Vec<PreparedStatic>,
    pub(crate) camera: Camera,
    pub(crate) local_from_camera: Rigid,
    pub(crate) options: RenderOptions,
    order: Vec<usize>,
}

pub(crate) struct PreparedObject<'a> {
    pub(crate) instance_id: u16,
    pub(crate) field: &'a Arc<Field>,
    pub(crate) object_from_local: Rigid,
    pub(crate) half_m: Vec3,
    pub(crate) tone: Tone,
    /// Pixels that may see the field.
    pub(crate) pixels: PixelBox,
    pub(crate) supersample: u32,
}

pub(crate) struct PreparedStatic {
    pub(crate) instance_id: u16,
    pub(crate) object_from_local: Rigid,
    pub(crate) half_m: Vec3,
    pub(crate) pixels: PixelBox,
}

impl PreparedObject<'_> {
    /// Nothing of an object is below its wheels; its field may have learnt a piece of road there.
    pub(crate) fn lowest_m(&self) -> f32 {
        const BELOW_WHEELS_M: f32 = 0.02;
        -self.half_m.z - BELOW_WHEELS_M
    }

    /// Background above this is haze in the object's box; below, it is the ground it stands on.
    pub(crate) fn floor_m(&self) -> f32 {
        const GROUND_KEPT_M: f32 = 0.05;
        -self.half_m.z + GROUND_KEPT_M
    }
}

impl<'a> Prepared<'a> {
    /// # Errors
    /// [`Error::Invalid`] for a bad camera or pose.
    pub(crate) fn checked(scene: &Scene<'a>, options: &RenderOptions) -> Result<Self> {
        scene.camera.validate("scene camera")?;
        check_poses(scene)?;
        Ok(Self::new(scene, options))
    }

    /// The ray through a continuous pixel position.
    pub(crate) fn eye_ray(&self, pixel: DVec2) -> EyeRay {
        let d_camera = self.camera.direction(pixel);
        let pose = &self.local_from_camera;
        EyeRay {
            origin: pose.translation_m.as_vec3(),
            direction: pose.direction(d_camera).as_vec3().normalize(),
            z_per_m: d_camera.z as f32,
        }
    }

    fn new(scene: &Scene<'a>, options: &RenderOptions) -> Self {
        let camera_from_local = scene.local_from_camera.inverse();
        let distance = |i: &usize| {
            let at = scene.objects[*i].local_from_object.translation_m;
            (at - scene.local_from_camera.translation_m).length()
        };
        let mut order: Vec<usize> = (0..scene.objects.len()).collect();
        order.sort_by(|a, b| {
            let bits = |i: &usize| scene.objects[*i].local_from_object.translation_m.to_array();
            distance(a)
                .total_cmp(&distance(b))
                .then_with(|| bits(a).map(f64::to_bits).cmp(&bits(b).map(f64::to_bits)))
                .then_with(|| {
                    scene.objects[*a]
                        .instance_id
                        .cmp(&scene.objects[*b].instance_id)
                })
        });
        let objects = order.iter().map(|i| {
            let object = &scene.objects[*i];
            let camera_from_object = camera_from_local * object.local_from_object;
            let (low, high) = object.field.bounds();
            let supersample = rays_per_side(scene, object, distance(i), options);
            PreparedObject {
                instance_id: object.instance_id,
                field: object.field,
                object_from_local: object.local_from_object.inverse(),
                half_m: (object.size_m * 0.5).as_vec3(),
                tone: object.tone,
                pixels: pixels_of(
                    &scene.camera,
                    &camera_from_object,
                    low.as_dvec3(),
                    high.as_dvec3(),
                ),
                supersample,
            }
        });
        let statics = scene.statics.iter().map(|object| {
            let half = object.size_m * 0.5 + DVec3::splat(STATIC_PADDING_M);
            PreparedStatic {
                instance_id: object.instance_id,
                object_from_local: object.local_from_object.inverse(),
                half_m: half.as_vec3(),
                pixels: pixels_of(
                    &scene.camera,
                    &(camera_from_local * object.local_from_object),
                    -half,
                    half,
                ),
            }
        });
        Self {
            background: scene.background,
            objects: objects.collect(),
            statics: statics.collect(),
            camera: scene.camera,
            local_from_camera: scene.local_from_camera,
            options: *options,
            order,
        }
    }
}

/// Annotated boxes of static objects are this tight around their reconstructed surface.
const STATIC_PADDING_M: f64 = 0.1;

/// Rays per pixel side for an object: further apart than its voxels, they would step over what it shows.
fn rays_per_side(
    scene: &Scene<'_>,
    object: &SceneObject<'_>,
    distance_m: f64,
    options: &RenderOptions,
) -> u32 {
    let pixel_m = distance_m / scene.camera.focal_px.x;
    let voxels = pixel_m / f64::from(object.field.finest_voxel_m());
    let wanted = if voxels > 0.5 {
        (voxels.ceil() as u32).clamp(2, options.object_supersample.max(2))
    } else {
        1
    };
    let least = options.supersample.max(1);
    wanted.min(options.object_supersample).max(least)
}

/// Everything in the image if part of the box is behind the camera, nothing if all is.
fn pixels_of(camera: &Camera, camera_from_box: &Rigid, low: DVec3, high: DVec3) -> PixelBox {
    let nothing = PixelBox {
        min: DVec2::ZERO,
        max: DVec2::ZERO,
    };
    let centre = (low + high) * 0.5;
    let shifted = Rigid::new(camera_from_box.rotation, camera_from_box.point(centre));
    box_of_corners(camera, &super::projection::corners(&shifted, high - low))
        .and_then(|b| b.clipped(camera))
        .unwrap_or(nothing)
}

/// Puts rendered tiles together.
pub(crate) fn assemble(prepared: &Prepared<'_>, tiles: Vec<TileResult>) -> RenderedFrame {
    let (width, height) = (prepared.camera.width, prepared.camera.height);
    let mut frame = RenderedFrame::empty(width, height);
    let mut alone = vec![0u32; prepared.objects.len() + prepared.statics.len()];
    for tile in tiles {
        for (total, own) in alone.iter_mut().zip(&tile.alone_px) {
            *total += own;
        }
        for (pair, px) in tile.hidden_px {
            *frame.hidden_px.entry(pair).or_default() += px;
        }
        for (i, pixel) in tile.pixels.iter().enumerate() {
            let (x, y) = (
                tile.x + i as u32 % tile.width,
                tile.y + i as u32 / tile.width,
            );
            let at = (y * width + x) as usize;
            frame.set_layers(at, pixel.behind_rgb, pixel.placed_rgb, pixel.placed_alpha);
            frame.depth_z_m[at] = pixel.depth_z_m;
            frame.behind_z_m[at] = pixel.behind_z_m;
            frame.instance[at] = pixel.instance;
            frame.accumulation[at] = pixel.accumulation;
        }
    }
    let mut objects = vec![(0, 0); prepared.objects.len()];
    for (i, object) in prepared.objects.iter().enumerate() {
        objects[prepared.order[i]] = (object.instance_id, alone[i]);
    }
    let statics = prepared
        .statics
        .iter()
        .zip(&alone[prepared.objects.len()..]);
    frame.alone_px = objects;
    frame
        .alone_px
        .extend(statics.map(|(object, px)| (object.instance_id, *px)));
    frame
}
