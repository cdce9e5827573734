//! Cast and contact shadows of placed objects on the ground, applied in linear light to a finished image.
//!
//! Each caster gets a map of its own ground plane: how much of the sun and of the sky's dome its field lets through to each place.
//! A ground pixel's light is then scaled by what is left of both. Surfaces off the caster's ground plane, and pixels that belong to
//! objects, keep their light.

use glam::{DVec2, DVec3};
use rayon::prelude::*;

use super::composition::{Composition, Origin};
use super::daylight::Daylight;
use super::frame::RenderedFrame;
use super::ground_light::GroundSun;
use super::linear::scale;
use super::render::{Scene, SceneObject};
use super::sun_grid::{SUN_LIFT_M, SUN_RANGE_M, transmittance};
use crate::field::{Field, RaySample};

const CELL_M: f64 = 0.1;
/// The dome is darkened up to this far from an object.
const CONTACT_REACH_M: f64 = 1.0;
const MAX_SHADOW_M: f64 = 8.0;
/// Heights around the caster's ground plane that count as its ground.
const GROUND_BELOW_M: f64 = 0.3;
const GROUND_ABOVE_M: f64 = 0.15;
/// Rays start above the layer in which object fields learn a piece of road.
const LIFT_M: f64 = 0.06;
/// Directions over the dome: rings x turns, weighted by cosine.
const DOME_RINGS: u32 = 3;
const DOME_TURNS: u32 = 8;

/// An instance that throws a shadow.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Caster {
    pub instance_id: u16,
    /// Where the recorded image is shown, a shadow like this one is in it already: the original mover's own.
    pub recorded: bool,
}

/// Instances of a composition whose shadows are missing from the background: inserts and replacements if the recipe wants
/// shadows, and replayed movers where the sun is known, because training then left their shadows out.
pub fn shadow_casters(composition: &Composition, sun_known: bool) -> Vec<Caster> {
    let casts = |origin: Origin| match origin {
        Origin::Inserted | Origin::Replaced | Origin::Moved => composition.insert_shadows,
        Origin::Replayed => sun_known,
        // A recorded mover's shadow lies in no field; its near part is in the recorded image around it.
        Origin::Recorded | Origin::Static => false,
    };
    let objects = composition.objects.iter();
    objects
        .filter(|o| casts(o.origin))
        .map(|o| Caster {
            instance_id: o.instance_id,
            recorded: !matches!(o.origin, Origin::Inserted | Origin::Moved),
        })
        .collect()
}

/// Darkens the ground under and behind the casters. Without daylight only the contact shadow remains. `shown` is the weight of the
/// recorded image per pixel.
pub fn cast_shadows(
    scene: &Scene<'_>,
    casters: &[Caster],
    daylight: Option<&Daylight>,
    shown: &[f32],
    frame: &mut RenderedFrame,
) {
    cast_shadows_on(scene, casters, daylight, None, shown, frame);
}

/// [`cast_shadows`] where it is known which ground lies in the sun anyway.
pub(super) fn cast_shadows_on(
    scene: &Scene<'_>,
    casters: &[Caster],
    daylight: Option<&Daylight>,
    ground: Option<&GroundSun<'_>>,
    shown: &[f32],
    frame: &mut RenderedFrame,
) {
    let sun = daylight.map(|day| day.sun_direction_local);
    let mut named: Vec<(&SceneObject<'_>, bool)> = scene
        .objects
        .iter()
        .filter_map(|o| {
            let caster = casters.iter().find(|c| c.instance_id == o.instance_id)?;
            Some((o, caster.recorded))
        })
        .collect();
    named.sort_by_key(|(o, _)| o.instance_id);
    let maps: Vec<ShadowMap<'_>> = named
        .par_iter()
        .map(|(object, recorded)| ShadowMap::new(object, *recorded, sun))
        .collect();
    if maps.is_empty() {
        return;
    }
    let background = scene.background.map(|field| -> &Field { field });
    let darkened: Vec<Option<[f32; 3]>> = (0..shown.len())
        .into_par_iter()
        .map_init(Vec::new, |samples, i| {
            let z = f64::from(frame.behind_z_m[i]);
            if z <= 0.0 || !frame.shows_behind(i) {
                return None;
            }
            let p = frame.point(scene, i, z);
            let blocked = light_left(&maps, f64::from(shown[i]), p)?;
            let left = match daylight {
                Some(day) => {
                    let known = ground.and_then(|g| g.on_ground(p));
                    let open = known.unwrap_or_else(|| open_sun(background, day, p, samples));
                    blocked.of_ground(day, open)
                }
                None => [blocked.dome; 3],
            };
            Some(scale(frame.behind_rgb[i], left))
        })
        .collect();
    for (i, rgb) in darkened.into_iter().enumerate() {
        if let Some(rgb) = rgb {
            frame.set_behind(i, rgb);
        }
    }
}

/// Parts of the sun and of the dome that the casters let through to a place.
#[derive(Clone, Copy, Debug)]
struct Left {
    sun: f64,
    dome: f64,
}

/// What all casters together leave of the light at a point; `None` if they leave all.
fn light_left(maps: &[ShadowMap<'_>], shown: f64, p: DVec3) -> Option<Left> {
    let mut left = Left {
        sun: 1.0,
        dome: 1.0,
    };
    for map in maps {
        let (sun, dome) = map.at(p);
        let cast = if map.recorded { 1.0 - shown } else { 1.0 };
        left.sun *= 1.0 - cast * (1.0 - sun);
        left.dome *= 1.0 - cast * (1.0 - dome);
    }
    (left.sun < 1.0 || left.dome < 1.0).then_some(left)
}

impl Left {
    /// Fraction of a ground point's light that is left, by channel, where the part `open` of the sun would reach it: ground in the shadow
    /// of the background has no sun to lose.
    fn of_ground(self, day: &Daylight, open: f64) -> [f64; 3] {
        day.sun_share.map(|share| {
            let (direct, diffuse) = (share * open, 1.0 - share);
            (direct * self.sun + diffuse * self.dome) / (direct + diffuse)
        })
    }
}

/// The part of the sun that reaches a ground point past the background.
fn open_sun(
    background: Option<&Field>,
    day: &Daylight,
    p: DVec3,
    samples: &mut Vec<RaySample>,
) -> f64 {
    let sun = day.sun_direction_local;
    let from = p + sun * (SUN_LIFT_M / sun.z);
    background.map_or(1.0, |b| transmittance(b, from, sun, SUN_RANGE_M, samples))
}

/// Light that reaches a caster's ground plane, on a grid in the caster's frame.
struct ShadowMap<'a> {
    object: &'a SceneObject<'a>,
    recorded: bool,
    low: DVec2,
    columns: usize,
    rows: usize,
    /// Parts of sun and dome that get through, row-major.
    light: Vec<(f64, f64)>,
}

impl<'a> ShadowMap<'a> {
    fn new(object: &'a SceneObject<'a>, recorded: bool, sun: Option<DVec3>) -> Self {
        let sun = sun.map(|d| object.local_from_object.inverse().direction(d));
        let (low, high) = object.field.bounds();
        let (low, high) = (low.as_dvec3().truncate(), high.as_dvec3().truncate());
        let reach = DVec2::splat(CONTACT_REACH_M);
        let (mut from, mut to) = (low - reach, high + reach);
        if let Some(sun) = sun.filter(|d| d.z > 0.0) {
            let length = (object.size_m.z / sun.z).min(MAX_SHADOW_M);
            let shift = -sun.truncate() * length;
            from = from.min(low + shift);
            to = to.max(high + shift);
        }
        let size = (to - from) / CELL_M;
        let (columns, rows) = (size.x.ceil() as usize + 1, size.y.ceil() as usize + 1);
        let mut map = Self {
            object,
            recorded,
            low: from,
            columns,
            rows,
            light: Vec::new(),
        };
        let mut samples = Vec::new();
        map.light = (0..columns * rows)
            .map(|i| map.light_at(i, sun, &mut samples))
            .collect();
        map
    }

    fn light_at(
        &self,
        index: usize,
        sun: Option<DVec3>,
        samples: &mut Vec<RaySample>,
    ) -> (f64, f64) {
        let cell = DVec2::new((index % self.columns) as f64, (index / self.columns) as f64);
        let ground = -self.object.size_m.z * 0.5 + LIFT_M;
        let p = (self.low + cell * CELL_M).extend(ground);
        let field = self.object.field;
        let mut through = |d: DVec3| transmittance(field, p, d, MAX_SHADOW_M, samples);
        let sun_part = sun.map_or(1.0, &mut through);
        let (low, high) = field.bounds();
        let (low, high) = (low.as_dvec3(), high.as_dvec3());
        let gap = (low - p).max(p - high).truncate().max(DVec2::ZERO);
        if gap.length() > CONTACT_REACH_M {
            return (sun_part, 1.0);
        }
        // Fades to nothing at the reach, so that the shadow has no rim.
        let fade = 1.0 - gap.length() / CONTACT_REACH_M;
        let mut dome = 0.0;
        for direction in dome_directions() {
            dome += through(direction);
        }
        let dome = dome / f64::from(DOME_RINGS * DOME_TURNS);
        (sun_part, 1.0 - fade * (1.0 - dome))
    }

    /// Parts of sun and dome left at a point of the background; (1, 1) off the ground plane or outside the map.
    fn at(&self, p: DVec3) -> (f64, f64) {
        let q = self.object.local_from_object.inverse().point(p);
        let above = q.z + self.object.size_m.z * 0.5;
        let c = (q.truncate() - self.low) / CELL_M;
        let inside = c.x >= 0.0
            && c.y >= 0.0
            && c.x < (self.columns - 1) as f64
            && c.y < (self.rows - 1) as f64;
        if !inside || !(-GROUND_BELOW_M..=GROUND_ABOVE_M).contains(&above) {
            return (1.0, 1.0);
        }
        let (column, row) = (c.x as usize, c.y as usize);
        let (fx, fy) = (c.x - column as f64, c.y - row as f64);
        let mut sum = (0.0, 0.0);
        for (dx, dy, weight) in [
            (0, 0, (1.0 - fx) * (1.0 - fy)),
            (1, 0, fx * (1.0 - fy)),
            (0, 1, (1.0 - fx) * fy),
            (1, 1, fx * fy),
        ] {
            let (sun, dome) = self.light[(row + dy) * self.columns + column + dx];
            sum.0 += weight * sun;
            sum.1 += weight * dome;
        }
        sum
    }
}

/// Directions whose density is that of the cosine over the dome.
fn dome_directions() -> impl Iterator<Item = DVec3> {
    (0..DOME_RINGS).flat_map(|ring| {
        // Equal parts of sin^2 of the polar angle carry equal cosine-weighted light.
        let sine = libm::sqrt((f64::from(ring) + 0.5) / f64::from(DOME_RINGS));
        (0..DOME_TURNS).map(move |turn| {
            let phase = f64::from(turn) + 0.5 * f64::from(ring % 2);
            let (s, c) = libm::sincos(phase / f64::from(DOME_TURNS) * std::f64::consts::TAU);
            DVec3::new(sine * c, sine * s, libm::sqrt(1.0 - sine * sine))
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Rigid;
    use crate::scene::daylight::SunSource;
    use crate::scene::solid_field::solid_field;
    use crate::scene::tone::Tone;
    use glam::Vec3;
    use std::sync::Arc;

    const SIZE: DVec3 = DVec3::new(4.0, 2.0, 1.6);

    fn car() -> Field {
        let half = (SIZE * 0.5).as_vec3();
        solid_field(-half - 0.2, half + 0.2, 0.1, [0.5; 3], |p: Vec3| {
            // Raised by 0.2 m: there is light under a car.
            let inside = p.abs().cmple(half).all() && p.z > 0.2 - half.z;
            if inside { 60.0 } else { 0.0 }
        })
    }

    fn left(sun: Option<DVec3>, x: f64, y: f64, z: f64) -> f64 {
        let field = Arc::new(car());
        let object = SceneObject {
            instance_id: 1,
            field: &field,
            local_from_object: Rigid::from_heading(0.0, DVec3::Z * 0.8),
            size_m: SIZE,
            tone: Tone::IDENTITY,
        };
        let day = sun.and_then(|sun| Daylight::clear_sky(sun, SunSource::Log));
        let maps = [ShadowMap::new(&object, false, sun)];
        let p = DVec3::new(x, y, z);
        let left = light_left(&maps, 0.0, p);
        left.map_or(1.0, |left| {
            day.map_or(left.dome, |day| left.of_ground(&day, 1.0)[0])
        })
    }

    #[test]
    fn the_shadow_lies_away_from_the_sun_on_the_ground_only() {
        let sun = Some(DVec3::new(0.0, 1.0, 1.0).normalize());
        let shaded = left(sun, 0.0, -1.8, 0.0);
        let sunny = left(sun, 0.0, 1.8, 0.0);
        assert!(shaded < 0.35, "{shaded}");
        assert!(sunny > 0.85, "{sunny}");
        assert_eq!(left(sun, 0.0, -8.0, 0.0), 1.0);
        assert_eq!(left(sun, 0.0, -1.8, 0.6), 1.0, "a wall's upper part");
    }

    #[test]
    fn contact_darkens_most_under_the_object_and_fades() {
        let (under, edge, beside, far) = (
            left(None, 0.0, 0.0, 0.0),
            left(None, 0.0, 1.15, 0.0),
            left(None, 0.0, 1.7, 0.0),
            left(None, 0.0, 2.6, 0.0),
        );
        assert!(under < 0.3 && under < edge && edge < beside && beside < 1.0);
        assert_eq!(far, 1.0);
    }
}
