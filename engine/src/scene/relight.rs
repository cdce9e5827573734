//! Moves placed objects from the sunlight they were recorded in into that of the place where they stand.
//!
//! A field holds the colours of its recording, light and all. At each of its pixels the surface's normal and the parts of the sun at
//! the source and at the place give two irradiances; their ratio scales the pixel in linear light. Gloss is scaled like paint.

use glam::{DVec2, DVec3};
use rayon::prelude::*;

use super::composition::{Candidate, Composition, Origin, PlacedObject, Stage};
use super::daylight::Daylight;
use super::frame::RenderedFrame;
use super::ground_light::{GroundSun, median};
use super::hull::entry_m;
use super::linear::scale;
use super::render::Scene;
use super::sun_grid::{SUN_RANGE_M, SunGrid, transmittance};
use super::surface::{Surface, nearest_surface};
use super::tone::Tone;
use crate::camera::Rigid;
use crate::field::{Field, RaySample};

/// An object's light at its source and at its place.
#[derive(Clone, Debug)]
pub struct ObjectLight {
    pub instance_id: u16,
    source: Source,
    place: SunGrid,
}

/// What is known of the light in which an object was recorded.
#[derive(Clone, Debug)]
enum Source {
    /// Where it stood in the background's own log, and the sun there.
    Poses(Vec<(Rigid, SunGrid)>),
    /// Its colours were matched to vehicles that this part of the sun reaches.
    Matched(f64),
}

/// Mean parts of the sun that reach an object, 0..=1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Relit {
    pub source_sun: f64,
    pub place_sun: f64,
}

/// A mover's light is the mean over this many of its poses.
const MAX_POSES: usize = 4;
/// Visible surfaces together face the sun as much as this part of level ground does.
const MEAN_FACING: f64 = 0.7;
/// The ground around an original that tells its light, on this grid, past the rim of its own contact shadow.
const RING_M: f64 = 2.0;
const RING_GAP_M: f64 = 0.8;
const RING_STEP_M: f64 = 0.5;
const LEAST_AROUND: usize = 12;
/// Panes, which mirror the sky in sun and shade alike, and noise would show more than paint beyond these.
const FACTOR: (f64, f64) = (0.2, 1.7);
/// Factors are means over this many pixels to each side: normals are noisier than paint.
const SMOOTH_PX: usize = 2;
/// Weights below change no byte.
const LEAST_WEIGHT: f32 = 1.0 / 512.0;

/// Light of the scene's inserted, replacing and moved objects, as far as their source is known: objects of the background's own log by their
/// recorded poses, those of other logs if `tones` brought them to the light of the frame's vehicles. Empty without daylight.
pub fn object_lights(
    stage: &Stage<'_>,
    scene: &Scene<'_>,
    composition: &Composition,
    library: &[Candidate],
    tones: &[(u16, Tone)],
) -> Vec<ObjectLight> {
    let Some(day) = composition.daylight else {
        return Vec::new();
    };
    let placed = |o: &&PlacedObject| {
        matches!(
            o.origin,
            Origin::Inserted | Origin::Replaced | Origin::Moved
        )
    };
    let objects: Vec<&PlacedObject> = composition.objects.iter().filter(placed).collect();
    let sun = Sun { stage, scene, day };
    let lights = objects.par_iter().map(|object| {
        let asset = &library[object.asset?];
        let matched = tones.iter().any(|(id, _)| *id == object.instance_id);
        let source = if asset.source_log == stage.source_log {
            sun.of_track(&asset.source_track_id)?
        } else if matched && object.origin == Origin::Inserted {
            Source::Matched(sun.of_vehicles(composition)?)
        } else {
            return None;
        };
        Some(ObjectLight {
            instance_id: object.instance_id,
            source,
            place: sun.at_place(object),
        })
    });
    lights.collect::<Vec<_>>().into_iter().flatten().collect()
}

impl ObjectLight {
    pub fn relit(&self) -> Relit {
        let source_sun = match &self.source {
            Source::Poses(poses) => {
                poses.iter().map(|(_, grid)| grid.mean()).sum::<f64>() / poses.len() as f64
            }
            Source::Matched(sun) => *sun,
        };
        Relit {
            source_sun,
            place_sun: self.place.mean(),
        }
    }

    /// Factors of linear light at a surface in the object's frame.
    fn factor(&self, day: &Daylight, local_from_object: &Rigid, surface: &Surface) -> [f64; 3] {
        let place_sun = self.place.at(surface.position);
        let ratio = |place: [f64; 3], source: [f64; 3]| -> [f64; 3] {
            std::array::from_fn(|c| (place[c] / source[c]).clamp(FACTOR.0, FACTOR.1))
        };
        match &self.source {
            Source::Poses(poses) => {
                let mut source = [0.0; 3];
                for (pose, grid) in poses {
                    let sun = grid.at(surface.position);
                    let own = day.irradiance(pose.direction(surface.normal), sun);
                    for (sum, own) in source.iter_mut().zip(own) {
                        *sum += own / poses.len() as f64;
                    }
                }
                let normal = local_from_object.direction(surface.normal);
                ratio(day.irradiance(normal, place_sun), source)
            }
            Source::Matched(sun) => {
                let light = |sun: f64| day.sun_share.map(|s| s * MEAN_FACING * sun + 1.0 - s);
                ratio(light(place_sun), light(*sun))
            }
        }
    }
}

/// Scales the placed objects' pixels of a rendered frame from their source's light to their place's.
pub fn relight(
    scene: &Scene<'_>,
    daylight: Option<&Daylight>,
    lights: &[ObjectLight],
    frame: &mut RenderedFrame,
) {
    let (Some(day), false) = (daylight, lights.is_empty()) else {
        return;
    };
    let factors: Vec<Option<(usize, [f64; 3])>> = (0..frame.placed_alpha.len())
        .into_par_iter()
        .map_init(Vec::new, |samples, i| {
            if frame.placed_alpha[i] < LEAST_WEIGHT {
                return None;
            }
            let surface = nearest_surface(scene, frame.pixel_centre(i), samples)?;
            let object = &scene.objects[surface.object];
            let light = lights
                .iter()
                .find(|l| l.instance_id == object.instance_id)?;
            let factor = light.factor(day, &object.local_from_object, &surface);
            Some((surface.object, factor))
        })
        .collect();
    let width = frame.width as usize;
    let lit: Vec<(usize, [f32; 3])> = (0..factors.len())
        .into_par_iter()
        .filter_map(|i| {
            let factor = mean_around(&factors, width, i)?;
            let alpha = frame.placed_alpha[i];
            let own = frame.placed_rgb[i].map(|c| c / alpha);
            Some((i, scale(own, factor).map(|c| c * alpha)))
        })
        .collect();
    for (i, rgb) in lit {
        frame.set_placed(i, rgb);
    }
}

/// Mean factor of the pixels around one that show the same object.
fn mean_around(factors: &[Option<(usize, [f64; 3])>], width: usize, i: usize) -> Option<[f64; 3]> {
    let (object, _) = factors[i]?;
    let (row, column) = (i / width, i % width);
    let rows = row.saturating_sub(SMOOTH_PX)..=(row + SMOOTH_PX).min(factors.len() / width - 1);
    let columns = column.saturating_sub(SMOOTH_PX)..=(column + SMOOTH_PX).min(width - 1);
    let (mut sum, mut count) = ([0.0; 3], 0.0);
    for y in rows {
        for x in columns.clone() {
            if let Some((_, factor)) = factors[y * width + x].filter(|(other, _)| *other == object)
            {
                for c in 0..3 {
                    sum[c] += factor[c];
                }
                count += 1.0;
            }
        }
    }
    Some(sum.map(|s| s / count))
}

/// Asks where the sun reaches.
struct Sun<'a> {
    stage: &'a Stage<'a>,
    scene: &'a Scene<'a>,
    day: Daylight,
}

impl Sun<'_> {
    /// Where an original of the background's own log was recorded.
    fn of_track(&self, track_id: &str) -> Option<Source> {
        let mut tracks = self.stage.recording.tracks.iter();
        let track = tracks.find(|t| t.track_id == track_id)?;
        let known: Vec<Rigid> = track.local_from_cuboid.iter().flatten().copied().collect();
        let wanted = if track.moving { MAX_POSES } else { 1 }.min(known.len());
        let poses = (0..wanted).map(|i| known[(2 * i + 1) * known.len() / (2 * wanted)]);
        let lit: Vec<(Rigid, SunGrid)> = poses
            .map(|pose| (pose, self.of_original(&pose, track.size_m)))
            .collect();
        (!lit.is_empty()).then_some(Source::Poses(lit))
    }

    /// By the ground around an original, as far as its own shadow does not lie there; past the background if too little of it is seen.
    fn of_original(&self, pose: &Rigid, size_m: DVec3) -> SunGrid {
        let ground = self.ground(&[pose.translation_m]);
        let cuboid_from_local = pose.inverse();
        let sun = self.day.sun_direction_local;
        let mut around: Vec<f64> = Vec::new();
        let half = size_m.truncate() * 0.5 + DVec2::splat(RING_M);
        let steps = (half / RING_STEP_M).ceil().as_ivec2();
        for y in -steps.y..=steps.y {
            for x in -steps.x..=steps.x {
                let at = DVec2::new(f64::from(x), f64::from(y)) * RING_STEP_M;
                let p = pose.point(at.extend(-0.5 * size_m.z));
                if entry_m(
                    &cuboid_from_local,
                    size_m + DVec3::splat(RING_GAP_M),
                    p,
                    sun,
                )
                .is_none()
                {
                    around.extend(ground.on_ground(p));
                }
            }
        }
        if around.len() >= LEAST_AROUND {
            return SunGrid::even(median(&mut around));
        }
        let mut samples = Vec::new();
        SunGrid::new(size_m, pose, sun, |_, from| {
            self.past_background(from, &mut samples)
        })
    }

    /// At a placed object: by the ground on which its own shadow will fall, past the background where that is not seen, and past the
    /// other placed objects.
    fn at_place(&self, object: &PlacedObject) -> SunGrid {
        let pose = object.local_from_object;
        let ground = self.ground(&[pose.translation_m]);
        let sun = self.day.sun_direction_local;
        let mut samples = Vec::new();
        SunGrid::new(object.size_m, &pose, sun, |p, from| {
            let seen = ground.through(p);
            let mut part = seen.unwrap_or_else(|| self.past_background(from, &mut samples));
            let others = self.scene.objects.iter();
            for other in others.filter(|o| o.instance_id != object.instance_id) {
                let to_other = other.local_from_object.inverse();
                let (from, along) = (to_other.point(from), to_other.direction(sun));
                part *= transmittance(other.field, from, along, SUN_RANGE_M, &mut samples);
            }
            part
        })
    }

    /// Mean part of the sun that reaches the frame's original vehicles, by the area they take in the image.
    fn of_vehicles(&self, composition: &Composition) -> Option<f64> {
        let originals = composition.objects.iter();
        let shown = originals.filter(|o| o.class.is_vehicle() && o.origin.is_as_recorded());
        let boxes = shown.map(PlacedObject::occupied);
        let (mut sum, mut total) = (0.0, 0.0);
        for vehicle in boxes.chain(composition.left_out.iter().map(|m| m.occupied)) {
            let pose = vehicle.local_from_cuboid;
            let away = (pose.translation_m - composition.local_from_camera.translation_m).length();
            let area = vehicle.size_m.z * vehicle.size_m.x / away.max(1.0).powi(2);
            sum += area * self.of_original(&pose, vehicle.size_m).mean();
            total += area;
        }
        (total > 0.0).then(|| sum / total)
    }

    fn ground(&self, centres: &[DVec3]) -> GroundSun<'_> {
        let background = self.scene.background.map(|field| -> &Field { field });
        GroundSun::around(self.stage, background, &self.day, centres)
    }

    fn past_background(&self, from: DVec3, samples: &mut Vec<RaySample>) -> f64 {
        let sun = self.day.sun_direction_local;
        match self.scene.background {
            Some(background) => transmittance(background, from, sun, SUN_RANGE_M, samples),
            None => 1.0,
        }
    }
}
