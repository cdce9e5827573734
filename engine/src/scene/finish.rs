//! Turns a rendered frame into a sample's image: the recorded image around the original movers, what nobody saw filled, shadows cast.

use std::sync::Arc;

use glam::DVec3;
use rayon::prelude::*;

use super::composition::{Composition, LeftOut, Origin, Stage};
use super::fill::{Part, fill};
use super::footprint::GroundPlane;
use super::frame::RenderedFrame;
use super::ground_light::GroundSun;
use super::hull::for_each_pixel;
use super::random::Draws;
use super::recorded::{RecordedImage, blend_rim, is_placed, show_recorded};
use super::render::Scene;
use super::seen::Sight;
use super::shadow::{Caster, cast_shadows_on, shadow_casters};
use super::silhouette::{Shape, silhouette};
use super::valid_region::ValidRegion;
use crate::camera::Rigid;
use crate::field::{Field, RaySample};

/// What a finished frame shows besides what was rendered and recorded.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Finished {
    /// 255 where a pixel is made up from its surroundings, because no frame of the log saw what is there: nothing to train on.
    /// `None` if there is no such pixel.
    pub ignore: Option<Vec<u8>>,
    /// How many such pixels there are.
    pub filled_px: u32,
}

/// A ray is judged where it has lost these parts of the light that the background takes.
const QUANTILES: [f32; 3] = [0.15, 0.5, 0.85];
const STOP_TAU: f32 = 5.0;
/// Where the ray meets nothing, a place this far away stands for its direction.
const FAR_M: f32 = 1000.0;
/// Ground is fitted this near to a mover and continued this far from the camera.
const GROUND_FIT_M: f64 = 8.0;
const GROUND_RANGE_M: f64 = 50.0;
/// Nearer, ground is filled smoothly: its light falls off gently under a car, and it has no texture but grain.
const SMOOTH_GROUND_M: f32 = 20.0;

/// Finishes the frame. `recorded` is the composition's frame as recorded, if it is to be had; `model` gives the field of a library index,
/// of left-out movers too. Pixels that no mover, no shadow and no fill reaches keep their bytes.
pub fn finish<'a>(
    stage: &Stage<'_>,
    scene: &Scene<'_>,
    composition: &Composition,
    recorded: Option<&RecordedImage<'_>>,
    model: impl Fn(usize) -> Option<&'a Field>,
    grain: Draws,
    frame: &mut RenderedFrame,
) -> Finished {
    let hidden = hidden_pixels(composition, recorded, model);
    let mut shown = match recorded {
        Some(image) => show_recorded(composition, image, &hidden, frame),
        None => vec![0.0; hidden.len()],
    };
    let filled = fill_unseen(stage, scene, composition, &hidden, grain, frame);
    if let Some(image) = recorded {
        // Filled from the recorded surroundings, shadow and all.
        for (shown, _) in shown.iter_mut().zip(&filled).filter(|(_, f)| **f) {
            *shown = 1.0;
        }
        blend_rim(image, &hidden, &mut shown, frame);
    }
    let casters = shadow_casters(composition, stage.recording.sun_direction_local.is_some());
    let daylight = composition.daylight.as_ref();
    let background = scene.background.map(Arc::as_ref);
    let ground = daylight
        .map(|day| GroundSun::around(stage, background, day, &places(composition, &casters)));
    cast_shadows_on(scene, &casters, daylight, ground.as_ref(), &shown, frame);
    let made_up = |i: usize| filled[i] && !is_placed(composition, frame.instance[i]);
    let mask: Vec<u8> = (0..filled.len())
        .map(|i| if made_up(i) { u8::MAX } else { 0 })
        .collect();
    let filled_px = mask.iter().filter(|v| **v != 0).count() as u32;
    Finished {
        ignore: (filled_px > 0).then_some(mask),
        filled_px,
    }
}

/// Centres of the objects that throw shadows.
fn places(composition: &Composition, casters: &[Caster]) -> Vec<DVec3> {
    let throws = |id: u16| casters.iter().any(|c| c.instance_id == id);
    let objects = composition.objects.iter();
    objects
        .filter(|o| throws(o.instance_id))
        .map(|o| o.local_from_object.translation_m)
        .collect()
}

/// Pixels of the recorded image that a left-out mover took and no staying one before it.
fn hidden_pixels<'a>(
    composition: &Composition,
    recorded: Option<&RecordedImage<'_>>,
    model: impl Fn(usize) -> Option<&'a Field>,
) -> Vec<bool> {
    let camera = &composition.camera;
    let camera_from_local = composition.local_from_camera.inverse();
    let mut begins = vec![f32::INFINITY; camera.pixel_count()];
    for mover in &composition.left_out {
        let own = left_out_silhouette(composition, recorded, mover, &model);
        for (begin, own) in begins.iter_mut().zip(own) {
            *begin = begin.min(own);
        }
    }
    let movers = composition.objects.iter();
    for mover in movers.filter(|o| o.origin == Origin::Recorded) {
        let pose = camera_from_local * mover.local_from_object;
        for_each_pixel(camera, &pose, mover.size_m, |i, z_m| {
            if z_m < f64::from(begins[i]) {
                begins[i] = f32::INFINITY;
            }
        });
    }
    begins.iter().map(|z| z.is_finite()).collect()
}

/// [`silhouette`] of a left-out mover by the best that is known of its shape.
pub(super) fn left_out_silhouette<'a>(
    composition: &Composition,
    recorded: Option<&RecordedImage<'_>>,
    mover: &LeftOut,
    model: impl Fn(usize) -> Option<&'a Field>,
) -> Vec<f32> {
    let camera = &composition.camera;
    let mask = recorded.and_then(|r| r.mask_of(&mover.track_id, camera.width, camera.height));
    let shape = Shape::best(mask.as_deref(), mover.asset.and_then(model));
    let camera_from_local = composition.local_from_camera.inverse();
    silhouette(camera, &camera_from_local, &mover.occupied, shape)
}

/// Fills the hidden pixels whose background no other frame saw; their depth follows the ground.
fn fill_unseen(
    stage: &Stage<'_>,
    scene: &Scene<'_>,
    composition: &Composition,
    hidden: &[bool],
    grain: Draws,
    frame: &mut RenderedFrame,
) -> Vec<bool> {
    let unseen = unseen_pixels(stage, scene, hidden, frame);
    if !unseen.contains(&true) {
        return unseen;
    }
    let plane = ground_plane(composition, stage.region);
    let is_smooth =
        |i: usize| ground_z(scene, &plane, frame, i).is_some_and(|z| z < SMOOTH_GROUND_M);
    let parts: Vec<Part> = (0..unseen.len())
        .map(|i| match unseen[i] {
            true if frame.shows_behind(i) && is_smooth(i) => Part::Smooth,
            true if frame.shows_behind(i) => Part::Hole,
            true => Part::Barrier,
            false if is_barrier(composition, frame, i) => Part::Barrier,
            false => Part::Known,
        })
        .collect();
    let mut texels: Vec<_> = (0..unseen.len())
        .map(|i| {
            let [r, g, b] = frame.behind_rgb[i];
            let z = frame.behind_z_m[i];
            [r, g, b, if z > 0.0 { z.recip() } else { 0.0 }]
        })
        .collect();
    fill(frame.width as usize, &mut texels, &parts, grain);
    for i in (0..unseen.len()).filter(|i| unseen[*i]) {
        let [r, g, b, nearness] = texels[i];
        frame.set_behind(i, [r, g, b]);
        let surface = if nearness > 0.0 {
            nearness.recip()
        } else {
            0.0
        };
        let z_m = ground_z(scene, &plane, frame, i).unwrap_or(surface);
        frame.behind_z_m[i] = z_m;
        if !is_placed(composition, frame.instance[i]) {
            frame.instance[i] = 0;
            frame.depth_z_m[i] = z_m;
            frame.accumulation[i] = f32::from(u8::from(z_m > 0.0)).max(frame.placed_alpha[i]);
        }
    }
    unseen
}

/// Neither background nor to be filled: original objects that stay, and what placed objects hide wholly.
fn is_barrier(composition: &Composition, frame: &RenderedFrame, i: usize) -> bool {
    let owner = frame.instance[i];
    let mut objects = composition.objects.iter();
    let stays = objects.any(|o| o.instance_id == owner && o.origin.is_as_recorded());
    !frame.shows_behind(i) || stays
}

/// The hidden pixels whose background was not seen by other frames.
fn unseen_pixels(
    stage: &Stage<'_>,
    scene: &Scene<'_>,
    hidden: &[bool],
    frame: &RenderedFrame,
) -> Vec<bool> {
    let Some(background) = scene.background.map(Arc::as_ref) else {
        return vec![false; hidden.len()];
    };
    let sight = Sight::new(background, stage.recording);
    (0..hidden.len())
        .into_par_iter()
        .map_init(Vec::new, |samples, i| {
            hidden[i]
                && (!frame.shows_behind(i)
                    || !is_seen(&sight, background, scene, frame, i, samples))
        })
        .collect()
}

/// Whether what the background shows in a pixel was seen: all of the places between which it takes most of the light.
fn is_seen(
    sight: &Sight<'_>,
    background: &Field,
    scene: &Scene<'_>,
    frame: &RenderedFrame,
    i: usize,
    samples: &mut Vec<RaySample>,
) -> bool {
    let pose = &scene.local_from_camera;
    let eye = pose.translation_m;
    let direction = pose.direction(scene.camera.direction(frame.pixel_centre(i)));
    samples.clear();
    let (from, along) = (eye.as_vec3(), direction.as_vec3().normalize());
    background.march(from, along, 0.0, f32::INFINITY, STOP_TAU, samples);
    let mut quantiles = QUANTILES.iter();
    let mut next = quantiles.next();
    let mut tau = 0.0;
    for sample in samples.iter() {
        tau += sample.sigma * sample.dt;
        let taken = -(-tau).exp_m1();
        let mut asked = false;
        while next.is_some_and(|part| taken >= *part) {
            next = quantiles.next();
            asked = true;
        }
        if asked && !sight.saw(eye + direction * f64::from(sample.t)) {
            return false;
        }
    }
    next.is_none() || sight.saw(eye + direction * f64::from(FAR_M))
}

/// The ground around the left-out movers, from the region's cells, or the movers' own bottoms where there are none.
fn ground_plane(composition: &Composition, region: &ValidRegion) -> GroundPlane {
    let mut points: Vec<DVec3> = Vec::new();
    for mover in &composition.left_out {
        let at = mover.occupied.local_from_cuboid.translation_m.truncate();
        let near = (0..region.cells.len()).filter(|i| {
            (region.centre(*i) - at).length() < GROUND_FIT_M && region.ground_m[*i].is_finite()
        });
        points.extend(near.map(|i| region.centre(i).extend(region.ground_m[i])));
    }
    if points.len() < 8 {
        points.extend(composition.left_out.iter().flat_map(|mover| {
            let bottom = DVec3::Z * (-0.5 * mover.occupied.size_m.z);
            let pose: Rigid = mover.occupied.local_from_cuboid;
            [-1.0, 0.0, 1.0].map(|x| pose.point(bottom + DVec3::X * x))
        }));
    }
    GroundPlane::fit(&points).expect("something was left out")
}

/// Camera z at which a pixel's ray meets the ground; `None` above the horizon and far off.
fn ground_z(
    scene: &Scene<'_>,
    plane: &GroundPlane,
    frame: &RenderedFrame,
    i: usize,
) -> Option<f32> {
    let in_camera = scene.camera.direction(frame.pixel_centre(i));
    let eye = scene.local_from_camera.translation_m;
    let direction = scene.local_from_camera.direction(in_camera);
    let falling = plane.slope.dot(direction.truncate()) - direction.z;
    let above = eye.z - plane.height_at(eye.truncate());
    let range = above / falling;
    let met = falling > 0.0 && range > 0.0 && range < GROUND_RANGE_M;
    met.then_some((range * in_camera.z) as f32)
}
