//! Matches the light of an object from another log to the light of the scene it is placed in.

use super::composition::{Candidate, Composition, Origin, Stage};
use super::finish::left_out_silhouette;
use super::hull::for_each_pixel;
use super::recorded::RecordedImage;
use super::render::{RenderOptions, Scene, SceneObject};
use crate::Result;
use crate::backend::Backend;
use crate::field::Field;

/// An affine change of colour in sRGB, per channel: `gain * c + offset`, then clamped.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tone {
    pub gain: [f32; 3],
    pub offset: [f32; 3],
}

impl Tone {
    pub const IDENTITY: Self = Self {
        gain: [1.0; 3],
        offset: [0.0; 3],
    };

    pub fn apply(&self, rgb: [f32; 3]) -> [f32; 3] {
        std::array::from_fn(|c| (self.gain[c] * rgb[c] + self.offset[c]).clamp(0.0, 1.0))
    }
}

impl Default for Tone {
    fn default() -> Self {
        Self::IDENTITY
    }
}

/// Quantiles of brightness that are matched: what is black on any vehicle (tyres, sills, panes), and what is bright on it.
const DARK: f64 = 0.15;
const BRIGHT: f64 = 0.8;
/// Fewer pixels say little about a vehicle's light.
const LEAST_PX: usize = 200;
/// Gains beyond these would change the paint instead of the light.
const GAIN: (f64, f64) = (0.45, 1.6);
/// Limit of the offset's difference between channels: a dark part may be painted.
const TINT: f64 = 0.02;
const LEAST_SPREAD: f64 = 0.05;
/// The middle of a cuboid is vehicle; its rim shows what is behind.
const CORE: f64 = 0.85;
/// The part of the pixel an object must fill to be measured there.
const SOLID: f32 = 0.95;

/// Tones of the scene's objects that come from another log, by instance id; the others keep theirs.
///
/// A replacement is matched to the recorded pixels of the mover whose slot it takes, an insert to those of all original vehicles in the
/// frame.
/// The gain is that of luminance, the same for every channel, so that paint keeps its hue; the offset brings the object's dark
/// parts to the colour of the recorded ones, which is the tint of the shade.
///
/// # Errors
/// What [`Backend::render`] fails with.
#[expect(clippy::too_many_arguments, reason = "all parts of one sample")]
pub fn match_tones<'a>(
    backend: &dyn Backend,
    stage: &Stage<'_>,
    scene: &Scene<'_>,
    composition: &Composition,
    library: &[Candidate],
    recorded: &RecordedImage<'_>,
    model: impl Fn(usize) -> Option<&'a Field>,
    cancelled: &(dyn Fn() -> bool + Sync),
) -> Result<Vec<(u16, Tone)>> {
    let mut tones = Vec::new();
    for object in &composition.objects {
        let Some(asset) = object.asset else { continue };
        let placed = matches!(object.origin, Origin::Inserted | Origin::Replaced);
        if !placed || library[asset].source_log == stage.source_log {
            continue;
        }
        let Some(in_scene) = scene
            .objects
            .iter()
            .find(|o| o.instance_id == object.instance_id)
        else {
            continue;
        };
        let target = match object.origin {
            Origin::Replaced => {
                replaced_pixels(composition, object.track_id.as_deref(), recorded, &model)
            }
            _ => vehicle_pixels(composition, recorded),
        };
        let source = own_pixels(backend, scene, in_scene, cancelled)?;
        if let (Some(from), Some(to)) = (Light::of(source), Light::of(target)) {
            tones.push((object.instance_id, from.tone_to(&to)));
        }
    }
    Ok(tones)
}

/// The object's own colours where it is solid, rendered without anything else.
fn own_pixels(
    backend: &dyn Backend,
    scene: &Scene<'_>,
    object: &SceneObject<'_>,
    cancelled: &(dyn Fn() -> bool + Sync),
) -> Result<Vec<[f32; 3]>> {
    let alone = Scene {
        background: None,
        objects: vec![SceneObject {
            tone: Tone::IDENTITY,
            ..*object
        }],
        statics: Vec::new(),
        camera: scene.camera,
        local_from_camera: scene.local_from_camera,
    };
    let options = RenderOptions {
        supersample: 1,
        object_supersample: 1,
    };
    let frame = backend.render(&alone, &options, cancelled)?;
    Ok((0..frame.placed_alpha.len())
        .filter(|i| frame.placed_alpha[*i] > SOLID)
        .map(|i| frame.placed_rgb[i].map(|c| c / frame.placed_alpha[i]))
        .collect())
}

/// Recorded colours of the left-out mover of a track.
fn replaced_pixels<'a>(
    composition: &Composition,
    track_id: Option<&str>,
    recorded: &RecordedImage<'_>,
    model: &impl Fn(usize) -> Option<&'a Field>,
) -> Vec<[f32; 3]> {
    let mut movers = composition.left_out.iter();
    let Some(mover) = movers.find(|m| Some(m.track_id.as_str()) == track_id) else {
        return Vec::new();
    };
    let camera = &composition.camera;
    let begins = left_out_silhouette(composition, Some(recorded), mover, model);
    let pose = composition.local_from_camera.inverse() * mover.occupied.local_from_cuboid;
    let mut pixels = Vec::new();
    for_each_pixel(camera, &pose, mover.occupied.size_m * CORE, |i, _| {
        if begins[i].is_finite() {
            pixels.push(recorded.at(camera.width, camera.height, i));
        }
    });
    pixels
}

/// Recorded colours of all original vehicles.
fn vehicle_pixels(composition: &Composition, recorded: &RecordedImage<'_>) -> Vec<[f32; 3]> {
    let camera = &composition.camera;
    let camera_from_local = composition.local_from_camera.inverse();
    let mut covered = vec![false; camera.pixel_count()];
    let originals = composition.objects.iter();
    let shown = originals.filter(|o| o.class.is_vehicle() && o.origin.is_as_recorded());
    let boxes = shown.map(|o| o.occupied());
    for occupied in boxes.chain(composition.left_out.iter().map(|m| m.occupied)) {
        let pose = camera_from_local * occupied.local_from_cuboid;
        for_each_pixel(camera, &pose, occupied.size_m * CORE, |i, _| {
            covered[i] = true;
        });
    }
    (0..covered.len())
        .filter(|i| covered[*i])
        .map(|i| recorded.at(camera.width, camera.height, i))
        .collect()
}

/// How light falls on a set of pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Light {
    /// Mean colour of the darkest pixels.
    dark_rgb: [f64; 3],
    dark: f64,
    bright: f64,
}

impl Light {
    /// `None` from too few pixels.
    fn of(mut pixels: Vec<[f32; 3]>) -> Option<Self> {
        if pixels.len() < LEAST_PX {
            return None;
        }
        pixels.sort_by(|a, b| value(a).total_cmp(&value(b)));
        let darkest = ((pixels.len() as f64 * DARK) as usize).max(1);
        let mut dark_rgb = [0.0; 3];
        for pixel in &pixels[..darkest] {
            for (sum, channel) in dark_rgb.iter_mut().zip(pixel) {
                *sum += f64::from(*channel) / darkest as f64;
            }
        }
        let bright = (pixels.len() as f64 * BRIGHT) as usize;
        Some(Self {
            dark_rgb,
            dark: value(&dark_rgb.map(|c| c as f32)),
            bright: value(&pixels[bright.min(pixels.len() - 1)]),
        })
    }

    fn tone_to(&self, target: &Self) -> Tone {
        let spread = (self.bright - self.dark).max(LEAST_SPREAD);
        let gain = ((target.bright - target.dark) / spread).clamp(GAIN.0, GAIN.1);
        let offset = target.dark - gain * self.dark;
        let shift: [f64; 3] = std::array::from_fn(|c| target.dark_rgb[c] - gain * self.dark_rgb[c]);
        let mean = shift.iter().sum::<f64>() / 3.0;
        Tone {
            gain: [gain as f32; 3],
            offset: shift.map(|s| (offset + (s - mean).clamp(-TINT, TINT)) as f32),
        }
    }
}

/// The strongest channel: unlike luminance it is as bright on red paint as on white.
fn value(rgb: &[f32; 3]) -> f64 {
    f64::from(rgb[0].max(rgb[1]).max(rgb[2]))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A vehicle: panes and tyres, paint, and a bright plate.
    fn pixels(light: impl Fn(f32) -> f32, paint: [f32; 3]) -> Vec<[f32; 3]> {
        let part = |rgb: [f32; 3], count: usize| vec![rgb.map(&light); count];
        [part([0.1; 3], 300), part(paint, 600), part([0.9; 3], 100)].concat()
    }

    fn worst(a: [f32; 3], b: [f32; 3]) -> f32 {
        (0..3).map(|c| (a[c] - b[c]).abs()).fold(0.0, f32::max)
    }

    #[test]
    fn an_affine_change_of_light_is_undone() {
        let paint = [0.8, 0.3, 0.2];
        let hazy = |v: f32| 0.3 + 0.65 * v;
        let from = Light::of(pixels(hazy, paint)).unwrap();
        let to = Light::of(pixels(|v| v, paint)).unwrap();
        let tone = from.tone_to(&to);
        for color in [[0.1; 3], paint, [0.5, 0.5, 0.4]] {
            assert!(worst(tone.apply(color.map(hazy)), color) < 0.02, "{tone:?}");
            assert!(
                worst(color.map(hazy), color) > 0.05,
                "there was something to undo"
            );
        }
    }

    #[test]
    fn the_same_light_is_the_identity_and_paint_keeps_its_hue() {
        let red = Light::of(pixels(|v| v, [0.8, 0.1, 0.1])).unwrap();
        let same = red.tone_to(&red);
        assert!(worst(same.apply([0.3, 0.6, 0.9]), [0.3, 0.6, 0.9]) < 1e-6);
        let grey = Light::of(pixels(|v| 0.5 * v, [0.4; 3])).unwrap();
        let [r, g, b] = red.tone_to(&grey).apply([0.8, 0.1, 0.1]);
        assert!(r > 3.0 * g.max(b), "{r} {g} {b}");
        assert!(r < 0.5, "in half the light");
    }

    #[test]
    fn gains_are_bounded_and_few_pixels_say_nothing() {
        let dull = Light::of(vec![[0.4; 3]; 500]).unwrap();
        let harsh = Light::of(pixels(|v| v, [1.0; 3])).unwrap();
        assert_eq!(dull.tone_to(&harsh).gain, [GAIN.1 as f32; 3]);
        assert_eq!(harsh.tone_to(&dull).gain, [GAIN.0 as f32; 3]);
        assert!(Light::of(vec![[0.4; 3]; LEAST_PX - 1]).is_none());
    }
}
