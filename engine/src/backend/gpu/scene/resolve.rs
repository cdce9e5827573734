//! From what rays show to pixels: who owns them, and which objects would be seen in them alone.

use glam::DVec2;

use super::HALF_TAU;
use super::batch::Shown;
use super::plan::{Pixels, Plan, Tile};
use crate::backend::MarchRay;
use crate::field::{MarchRange, Ray};
use crate::scene::{EyeRay, HALF, Pixel, Prepared, TileResult, crosses, holds, owner, touches};

/// A static object that may be seen in a pixel if nothing stands before it: if the background along this ray takes half of the light.
#[derive(Clone, Copy, Debug)]
pub(super) struct Question {
    pub(super) ray: MarchRay,
    tile: usize,
    /// Of the tile's counts.
    slot: usize,
    instance: u16,
    owner: u16,
}

/// Tiles of a frame, and what is still to be asked about them.
pub(super) struct Resolved<'a> {
    scene: &'a Prepared<'a>,
    tiles: Vec<TileResult>,
    questions: Vec<Question>,
    weight: Vec<f32>,
    alone: Vec<f32>,
}

impl<'a> Resolved<'a> {
    pub(super) fn new(scene: &'a Prepared<'a>) -> Self {
        Self {
            scene,
            tiles: Vec::new(),
            questions: Vec::new(),
            weight: vec![0.0; scene.objects.len()],
            alone: vec![0.0; scene.objects.len()],
        }
    }

    /// Takes the next tile, whose first pixel is number `first` of the batch.
    pub(super) fn take(
        &mut self,
        tile: Tile,
        first: usize,
        pixels: &Pixels,
        plan: &Plan,
        shown: &Shown,
    ) {
        let count = (tile.width * tile.height) as usize;
        let mut result = TileResult {
            x: tile.x,
            y: tile.y,
            width: tile.width,
            pixels: Vec::with_capacity(count),
            alone_px: vec![0; self.scene.objects.len() + self.scene.statics.len()],
            hidden_px: Default::default(),
        };
        for number in first..first + count {
            let pixel = self.pixel(number, pixels, plan, shown, &mut result);
            result.pixels.push(pixel);
        }
        self.tiles.push(result);
    }

    fn pixel(
        &mut self,
        number: usize,
        pixels: &Pixels,
        plan: &Plan,
        shown: &Shown,
        tile: &mut TileResult,
    ) -> Pixel {
        let active = pixels.active(number);
        for object in active {
            (self.weight[*object as usize], self.alone[*object as usize]) = (0.0, 0.0);
        }
        let rays = plan.rays(number);
        let share = 1.0 / rays.len() as f32;
        let mut pixel = Pixel::default();
        for ray in rays.clone() {
            add(&mut pixel.behind_rgb, share, shown.colors[ray]);
            pixel.accumulation += share * (1.0 - shown.hits[ray].transmittance);
            for (pair, object) in plan.pairs(ray).iter().zip(active) {
                let (pair, object) = (*pair as usize, *object as usize);
                add(&mut pixel.placed_rgb, share, shown.pair_colors[pair]);
                self.weight[object] += share * shown.pairs[pair].total_weight;
                self.alone[object] += share * shown.pairs[pair].alone;
            }
        }
        let objects = &self.scene.objects;
        let weights = active.iter().map(|o| *o as usize);
        let weights = weights.map(|o| (objects[o].instance_id, self.weight[o]));
        pixel.placed_alpha = weights
            .clone()
            .map(|(_, weight)| weight)
            .sum::<f32>()
            .min(1.0);
        pixel.instance = owner(weights);
        // The sub-ray nearest the pixel's centre gives its depth: depths of two surfaces have no mean.
        let side = plan.requests[rays.start].side as usize;
        let hit = shown.hits[rays.start + (side / 2) * (side + 1)];
        let distance = |t: f32| (t >= 0.0).then_some(t);
        let (half_t, background_half_t) = (distance(hit.half_t), distance(hit.background_half_t));
        pixel.depth_z_m = half_t.map_or(0.0, |t| t * hit.z_per_m);
        pixel.behind_z_m = background_half_t.map_or(0.0, |t| t * hit.z_per_m);
        let [x, y] = pixels.at[number];
        let corner = DVec2::new(f64::from(x), f64::from(y));
        self.find_statics(corner, side, [half_t, background_half_t], &mut pixel, tile);
        for object in active.iter().map(|o| *o as usize) {
            if self.alone[object] >= HALF {
                let instance = self.scene.objects[object].instance_id;
                tile.count_alone(object, instance, pixel.instance);
            }
        }
        pixel
    }

    /// Gives the pixel to a static object whose cuboid holds its surface, and counts or asks whether each would be seen alone.
    fn find_statics(
        &mut self,
        corner: DVec2,
        side: usize,
        [half_t, background_half_t]: [Option<f32>; 2],
        pixel: &mut Pixel,
        tile: &mut TileResult,
    ) {
        let scene = self.scene;
        let mut ray: Option<EyeRay> = None;
        for (number, object) in scene.statics.iter().enumerate() {
            if !touches(&object.pixels, corner + 0.5) {
                continue;
            }
            let centre = (side / 2) as f64 + 0.5;
            let ray = *ray.get_or_insert_with(|| scene.eye_ray(corner + centre / side as f64));
            let is_held = |t: Option<f32>| t.is_some_and(|t| holds(object, ray, t));
            if pixel.instance == 0 && is_held(half_t) {
                pixel.instance = object.instance_id;
            }
            let slot = scene.objects.len() + number;
            if is_held(background_half_t) {
                tile.count_alone(slot, object.instance_id, pixel.instance);
            } else if scene.background.is_some()
                && let Some((t_min, t_max)) = crosses(object, ray)
            {
                self.questions.push(Question {
                    ray: MarchRay {
                        ray: Ray {
                            origin: ray.origin,
                            direction: ray.direction,
                        },
                        range: MarchRange {
                            t_min,
                            t_max,
                            stop_tau: HALF_TAU,
                            phase: 0.5,
                        },
                    },
                    tile: self.tiles.len(),
                    slot,
                    instance: object.instance_id,
                    owner: pixel.instance,
                });
            }
        }
    }

    /// What is to be asked of the background.
    pub(super) fn questions(&self) -> &[Question] {
        &self.questions
    }

    /// The tiles, given the optical depth along each question's ray.
    pub(super) fn answered(mut self, taus: &[f32]) -> Vec<TileResult> {
        assert_eq!(taus.len(), self.questions.len(), "an answer each");
        for (question, tau) in self.questions.iter().zip(taus) {
            if *tau >= HALF_TAU {
                let tile = &mut self.tiles[question.tile];
                tile.count_alone(question.slot, question.instance, question.owner);
            }
        }
        self.tiles
    }
}

fn add(sum: &mut [f32; 3], share: f32, color: [f32; 4]) {
    for (channel, own) in sum.iter_mut().zip(color) {
        *channel += share * own;
    }
}
