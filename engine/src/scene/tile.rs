//! Renders one tile of a scene: marches its rays, merges them, and asks each field for its colours in one batch.

use std::collections::BTreeMap;

use glam::{DVec2, Vec3};

use super::merge::{composite, merge};
use super::projection::PixelBox;
use super::render::{Prepared, PreparedStatic};
use super::tone::Tone;
use crate::field::{ColorScratch, Ray, RaySample};

/// Side of a tile: large enough to fill colour batches, small enough to spread over threads.
pub(crate) const TILE_PX: u32 = 32;
/// March until less than a thousandth of the light is left.
pub(crate) const STOP_TAU: f32 = 7.0;
/// Where an object's box suppresses background haze, marching must not have ended in that haze.
pub(crate) const STOP_TAU_THROUGH_OBJECT: f32 = 40.0;
/// Samples of less weight get no colour of their own; the rest of the ray is scaled up for them.
pub(crate) const MIN_WEIGHT: f32 = 1e-3;
/// The lowest part of a static object's cuboid is road.
const STATIC_GROUND_M: f32 = 0.2;
pub(crate) const HALF: f32 = 0.5;
const HALF_TAU: f32 = std::f32::consts::LN_2;

/// One finished pixel.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Pixel {
    /// Background and sky, weighted as composited.
    pub(crate) behind_rgb: [f32; 3],
    pub(crate) placed_rgb: [f32; 3],
    pub(crate) placed_alpha: f32,
    pub(crate) depth_z_m: f32,
    pub(crate) behind_z_m: f32,
    pub(crate) instance: u16,
    pub(crate) accumulation: f32,
}

#[derive(Default)]
pub(crate) struct TileResult {
    pub(crate) x: u32,
    pub(crate) y: u32,
    pub(crate) width: u32,
    pub(crate) pixels: Vec<Pixel>,
    /// Objects, then statics.
    pub(crate) alone_px: Vec<u32>,
    /// Pixels by (hidden object, instance that owns the pixel).
    pub(crate) hidden_px: BTreeMap<(u16, u16), u32>,
}

impl TileResult {
    pub(crate) fn count_alone(&mut self, slot: usize, instance: u16, owner: u16) {
        self.alone_px[slot] += 1;
        if owner != instance {
            *self.hidden_px.entry((instance, owner)).or_default() += 1;
        }
    }
}

/// A camera ray in the background's frame.
#[derive(Clone, Copy)]
pub(crate) struct EyeRay {
    pub(crate) origin: Vec3,
    pub(crate) direction: Vec3,
    /// Camera z per metre along the ray.
    pub(crate) z_per_m: f32,
}

/// Samples waiting for their colours, all of one field.
#[derive(Default)]
struct Batch {
    positions: Vec<Vec3>,
    directions: Vec<Vec3>,
    /// Pixel of the tile and weight.
    targets: Vec<(u32, f32)>,
}

/// What one ray contributes to its pixel besides colour.
#[derive(Clone, Copy, Default)]
struct Hit {
    transmittance: f32,
    half_t: Option<f32>,
    /// Distance at which the background alone hides half of the light.
    background_half_t: Option<f32>,
}

/// Buffers of one thread; nothing is allocated per ray.
pub(super) struct TileRenderer<'a> {
    scene: &'a Prepared<'a>,
    /// Source 0 is the background, source 1 + i is `active[i]`.
    sources: Vec<Vec<RaySample>>,
    weights: Vec<Vec<f32>>,
    active: Vec<usize>,
    cursors: Vec<usize>,
    batches: Vec<Batch>,
    colors: Vec<[f32; 3]>,
    scratch: ColorScratch,
    object_weight: Vec<f32>,
    object_alone: Vec<f32>,
}

impl<'a> TileRenderer<'a> {
    pub(super) fn new(scene: &'a Prepared<'a>) -> Self {
        let objects = scene.objects.len();
        Self {
            scene,
            sources: vec![Vec::new(); objects + 1],
            weights: vec![Vec::new(); objects + 1],
            active: Vec::with_capacity(objects),
            cursors: Vec::with_capacity(objects + 1),
            batches: (0..=objects).map(|_| Batch::default()).collect(),
            colors: Vec::new(),
            scratch: ColorScratch::default(),
            object_weight: vec![0.0; objects],
            object_alone: vec![0.0; objects],
        }
    }

    pub(super) fn render(&mut self, x: u32, y: u32) -> TileResult {
        let camera = &self.scene.camera;
        let width = TILE_PX.min(camera.width - x);
        let height = TILE_PX.min(camera.height - y);
        let mut tile = TileResult {
            x,
            y,
            width,
            pixels: vec![Pixel::default(); (width * height) as usize],
            alone_px: vec![0; self.scene.objects.len() + self.scene.statics.len()],
            hidden_px: BTreeMap::new(),
        };
        for i in 0..width * height {
            let corner = DVec2::new(f64::from(x + i % width), f64::from(y + i / width));
            self.render_pixel(corner, i, &mut tile);
        }
        self.shade(&mut tile);
        tile
    }

    fn render_pixel(&mut self, corner: DVec2, index: u32, tile: &mut TileResult) {
        let scene = self.scene;
        let centre = corner + DVec2::splat(0.5);
        self.active.clear();
        let mut side = scene.options.supersample.max(1);
        for (i, object) in scene.objects.iter().enumerate() {
            if touches(&object.pixels, centre) {
                self.active.push(i);
                (self.object_weight[i], self.object_alone[i]) = (0.0, 0.0);
            }
        }
        side = side.max(self.object_side(corner));
        let share = 1.0 / (side * side) as f32;
        let mut first: Option<(EyeRay, Hit)> = None;
        let pixel = &mut tile.pixels[index as usize];
        for sub in 0..side * side {
            let ray = self.scene.eye_ray(corner + sub_pixel(sub, side));
            let hit = self.trace(ray, index, share);
            let sky = scene.background.map_or([0.0; 3], |b| b.sky(ray.direction));
            for (channel, sky) in pixel.behind_rgb.iter_mut().zip(sky) {
                *channel += share * hit.transmittance * sky;
            }
            pixel.accumulation += share * (1.0 - hit.transmittance);
            // The sub-ray nearest the pixel's centre gives its depth: depths of two surfaces have no mean.
            if sub == (side / 2) * (side + 1) {
                first = Some((ray, hit));
            }
        }
        let (ray, hit) = first.expect("every pixel has a central ray");
        pixel.depth_z_m = hit.half_t.map_or(0.0, |t| t * ray.z_per_m);
        pixel.behind_z_m = hit.background_half_t.map_or(0.0, |t| t * ray.z_per_m);
        pixel.placed_alpha = self.placed_weight().min(1.0);
        let weights = self.active.iter();
        pixel.instance =
            owner(weights.map(|i| (scene.objects[*i].instance_id, self.object_weight[*i])));
        self.find_static(ray, hit, centre, index, tile);
        let owner = tile.pixels[index as usize].instance;
        for i in &self.active {
            if self.object_alone[*i] >= HALF {
                tile.count_alone(*i, self.scene.objects[*i].instance_id, owner);
            }
        }
    }

    /// Rays per pixel side that the objects met within the pixel ask for: an object nobody meets must change nothing.
    fn object_side(&mut self, corner: DVec2) -> u32 {
        let mut side = 1;
        for slot in 0..self.active.len() {
            let wanted = self.scene.objects[self.active[slot]].supersample;
            let meets = wanted > side
                && (0..wanted * wanted).any(|sub| {
                    let ray = self.scene.eye_ray(corner + sub_pixel(sub, wanted));
                    self.sources[1 + slot].clear();
                    self.march_object(ray, slot, 0.0)
                });
            if meets {
                side = wanted;
            }
        }
        side
    }

    /// Marches and merges one ray; queues its samples for colouring.
    fn trace(&mut self, ray: EyeRay, pixel: u32, share: f32) -> Hit {
        let scene = self.scene;
        for source in &mut self.sources {
            source.clear();
        }
        let mut through_object = false;
        for slot in 0..self.active.len() {
            through_object |= self.march_object(ray, slot, share);
        }
        let stop = if through_object {
            STOP_TAU_THROUGH_OBJECT
        } else {
            STOP_TAU
        };
        if let Some(background) = scene.background {
            let out = &mut self.sources[0];
            background.march(ray.origin, ray.direction, 0.0, f32::INFINITY, stop, out);
        }
        if !through_object {
            let merged = composite(&self.sources[0], &mut self.weights[0]);
            self.queue(0, ray.origin, ray.direction, pixel, share);
            return Hit {
                transmittance: merged.transmittance,
                half_t: merged.half_t,
                background_half_t: merged.half_t,
            };
        }
        let alone = composite(&self.sources[0], &mut self.weights[0]);
        self.suppress_haze(ray);
        let used = 1 + self.active.len();
        let merged = merge(
            &self.sources[..used],
            &mut self.weights[..used],
            &mut self.cursors,
        );
        self.queue(0, ray.origin, ray.direction, pixel, share);
        for slot in 0..self.active.len() {
            let i = self.active[slot];
            self.object_weight[i] += share * self.weights[1 + slot].iter().sum::<f32>();
            let object = &scene.objects[i];
            let origin = object.object_from_local.point(ray.origin.as_dvec3());
            let direction = object.object_from_local.direction(ray.direction.as_dvec3());
            self.queue(
                1 + slot,
                origin.as_vec3(),
                direction.as_vec3(),
                pixel,
                share,
            );
        }
        Hit {
            transmittance: merged.transmittance,
            half_t: merged.half_t,
            background_half_t: alone.half_t,
        }
    }

    /// Samples of the object in `active[slot]`; whether the ray meets any.
    fn march_object(&mut self, ray: EyeRay, slot: usize, share: f32) -> bool {
        let i = self.active[slot];
        let object = &self.scene.objects[i];
        let to_object = &object.object_from_local;
        let origin = to_object.point(ray.origin.as_dvec3()).as_vec3();
        let direction = to_object.direction(ray.direction.as_dvec3()).as_vec3();
        let samples = &mut self.sources[1 + slot];
        object
            .field
            .march(origin, direction, 0.0, f32::INFINITY, STOP_TAU, samples);
        let lowest = object.lowest_m();
        samples.retain(|s| origin.z + s.t * direction.z >= lowest);
        let tau: f32 = samples.iter().map(|s| s.sigma * s.dt).sum();
        self.object_alone[i] -= share * (-tau).exp_m1();
        !samples.is_empty()
    }

    /// Background density inside the cuboid of an object that the ray meets is haze (or the object's own ghost) unless it is the ground.
    fn suppress_haze(&mut self, ray: EyeRay) {
        for (slot, i) in self.active.iter().enumerate() {
            if self.sources[1 + slot].is_empty() {
                continue;
            }
            let object = &self.scene.objects[*i];
            let to_object = &object.object_from_local;
            let origin = to_object.point(ray.origin.as_dvec3()).as_vec3();
            let direction = to_object.direction(ray.direction.as_dvec3()).as_vec3();
            let floor = object.floor_m();
            self.sources[0].retain(|s| {
                let p = origin + direction * s.t;
                let inside = p.abs().cmple(object.half_m).all();
                !(inside && p.z > floor)
            });
        }
    }

    fn queue(&mut self, source: usize, origin: Vec3, direction: Vec3, pixel: u32, share: f32) {
        let weights = &self.weights[source];
        let total: f32 = weights.iter().sum();
        let kept: f32 = weights.iter().filter(|w| **w >= MIN_WEIGHT).sum();
        if kept <= 0.0 {
            return;
        }
        let scale = share * total / kept;
        let batch = match source {
            0 => &mut self.batches[0],
            slot => &mut self.batches[1 + self.active[slot - 1]],
        };
        for (sample, weight) in self.sources[source].iter().zip(weights) {
            if *weight >= MIN_WEIGHT {
                batch.positions.push(origin + direction * sample.t);
                batch.directions.push(direction);
                batch.targets.push((pixel, weight * scale));
            }
        }
    }

    fn placed_weight(&self) -> f32 {
        self.active.iter().map(|i| self.object_weight[*i]).sum()
    }

    /// Marks the pixel of a static object whose cuboid holds its surface, and counts the pixels it would have alone.
    fn find_static(
        &mut self,
        ray: EyeRay,
        hit: Hit,
        centre: DVec2,
        index: u32,
        tile: &mut TileResult,
    ) {
        let scene = self.scene;
        for (i, object) in scene.statics.iter().enumerate() {
            if !touches(&object.pixels, centre) {
                continue;
            }
            let pixel = &mut tile.pixels[index as usize];
            if pixel.instance == 0 && hit.half_t.is_some_and(|t| holds(object, ray, t)) {
                pixel.instance = object.instance_id;
            }
            let owner = pixel.instance;
            let alone = hit.background_half_t.is_some_and(|t| holds(object, ray, t))
                || self.is_solid_within(object, ray);
            if alone {
                tile.count_alone(scene.objects.len() + i, object.instance_id, owner);
            }
        }
    }

    /// Whether the background inside a static object's cuboid would stop the ray if nothing stood before it.
    fn is_solid_within(&mut self, object: &PreparedStatic, ray: EyeRay) -> bool {
        let Some(background) = self.scene.background else {
            return false;
        };
        let Some((enter, leave)) = crosses(object, ray) else {
            return false;
        };
        let samples = &mut self.sources[0];
        samples.clear();
        let (origin, direction) = (ray.origin, ray.direction);
        let tau = background.march(origin, direction, enter, leave, HALF_TAU, samples);
        tau >= HALF_TAU
    }

    /// Colours every queued sample and adds it to its pixel.
    fn shade(&mut self, tile: &mut TileResult) {
        let fields = self.scene.background.into_iter().map(|f| (0, f));
        let objects = self.scene.objects.iter().enumerate();
        for (b, field) in fields.chain(objects.map(|(i, o)| (1 + i, o.field))) {
            let batch = &mut self.batches[b];
            field.colors(
                &batch.positions,
                &batch.directions,
                &mut self.colors,
                &mut self.scratch,
            );
            if let Some(tone) = b.checked_sub(1).map(|i| self.scene.objects[i].tone)
                && tone != Tone::IDENTITY
            {
                for color in &mut self.colors {
                    *color = tone.apply(*color);
                }
            }
            for ((pixel, weight), color) in batch.targets.iter().zip(&self.colors) {
                let pixel = &mut tile.pixels[*pixel as usize];
                let rgb = match b {
                    0 => &mut pixel.behind_rgb,
                    _ => &mut pixel.placed_rgb,
                };
                for (channel, color) in rgb.iter_mut().zip(color) {
                    *channel += weight * color;
                }
            }
            batch.positions.clear();
            batch.directions.clear();
            batch.targets.clear();
        }
    }
}

/// Position in the pixel of sub-ray `sub` of `side * side`.
fn sub_pixel(sub: u32, side: u32) -> DVec2 {
    let offset = DVec2::new(f64::from(sub % side) + 0.5, f64::from(sub / side) + 0.5);
    offset / f64::from(side)
}

/// The object that owns a pixel, of all that may be seen in it with their weights: all of them carry half of the pixel's weight, this
/// one most of theirs.
pub(crate) fn owner(weights: impl Iterator<Item = (u16, f32)> + Clone) -> u16 {
    let placed: f32 = weights.clone().map(|(_, weight)| weight).sum();
    if placed < HALF {
        return 0;
    }
    let heaviest = weights.max_by(|a, b| a.1.total_cmp(&b.1));
    heaviest.map_or(0, |(instance, _)| instance)
}

pub(crate) fn touches(pixels: &PixelBox, centre: DVec2) -> bool {
    // One pixel of slack: sub-rays leave the centre.
    centre.cmpge(pixels.min - 1.0).all() && centre.cmple(pixels.max + 1.0).all()
}

/// Where a ray is inside a static object's cuboid, road left out.
pub(crate) fn crosses(object: &PreparedStatic, ray: EyeRay) -> Option<(f32, f32)> {
    let to_object = &object.object_from_local;
    let local = Ray {
        origin: to_object.point(ray.origin.as_dvec3()).as_vec3(),
        direction: to_object.direction(ray.direction.as_dvec3()).as_vec3(),
    };
    let low = (-object.half_m).with_z(-object.half_m.z + STATIC_GROUND_M);
    local.cross_box(low, object.half_m)
}

/// Whether the place at distance `t` is in a static object's cuboid, road left out.
pub(crate) fn holds(object: &PreparedStatic, ray: EyeRay, t: f32) -> bool {
    let p = (ray.origin + ray.direction * t).as_dvec3();
    let p = object.object_from_local.point(p).as_vec3();
    p.abs().cmple(object.half_m).all() && p.z > -object.half_m.z + STATIC_GROUND_M
}
