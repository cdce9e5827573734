//! Checks of training input before the first step.

use glam::{DVec2, DVec3, Vec3};

use super::input::{BoundedInput, LidarBeam};
use super::preset::TrainPreset;
use super::refine::BRICK_BYTES;
use crate::camera::Camera;
use crate::field::{ColorMlp, Field};
use crate::view::{PixelLabel, Split, TrainView};
use crate::{Error, Result};

/// Farther from the local origin than this, f32 positions are coarser than a voxel.
const FAR_M: f64 = 1e5;
/// Points per axis at which a box is looked for in the images.
const BOX_POINTS: u32 = 9;

/// Checks every view; `kind` names the job in messages.
pub(super) fn validate_views(kind: &str, views: &[TrainView]) -> Result<()> {
    for view in views {
        let frame = format!("{kind}: frame {}", view.frame_index);
        view.camera.validate(&frame)?;
        if !view.local_from_camera.is_finite() {
            return Err(Error::invalid(format!(
                "{frame}: local_from_camera is not finite"
            )));
        }
        let away_m = view.local_from_camera.translation_m.length();
        if away_m > FAR_M {
            return Err(Error::invalid(format!(
                "{frame}: local_from_camera is {away_m:.0} m from the local origin; anchor the local frame near the log"
            )));
        }
        validate_directions(&frame, &view.camera)?;
        if (view.local_from_camera.rotation.length() - 1.0).abs() > 1e-6 {
            return Err(Error::invalid(format!(
                "{frame}: local_from_camera.rotation is not a unit quaternion"
            )));
        }
        let pixels = view.camera.pixel_count();
        if view.rgb.len() != 3 * pixels {
            return Err(Error::invalid(format!(
                "{frame}: rgb has {} bytes, its camera's {}x{} image needs {}",
                view.rgb.len(),
                view.camera.width,
                view.camera.height,
                3 * pixels
            )));
        }
        if view.labels.len() != pixels {
            return Err(Error::invalid(format!(
                "{frame}: labels has {} pixels, its camera's image {pixels}; resize the mask to the image",
                view.labels.len()
            )));
        }
        validate_depth(&frame, view)?;
    }
    let train = views.iter().filter(|view| view.split == Split::Train);
    let known = |view: &TrainView| view.labels.iter().any(|l| *l != PixelLabel::Unknown);
    if train.clone().next().is_none() {
        return Err(Error::invalid(format!("{kind}: no training view")));
    }
    if !train.clone().any(known) {
        return Err(Error::invalid(format!(
            "{kind}: no ray is left, every pixel of every training view is labelled unknown"
        )));
    }
    Ok(())
}

/// Every corner's ray exists: finite figures alone may still be a lens that maps no direction to a pixel.
fn validate_directions(frame: &str, camera: &Camera) -> Result<()> {
    let size = DVec2::new(f64::from(camera.width), f64::from(camera.height));
    for corner in 0..4u32 {
        let share = DVec2::new(f64::from(corner & 1), f64::from(corner >> 1));
        let direction = camera.direction(size * share);
        if !direction.is_finite() || direction.z <= 0.0 {
            return Err(Error::invalid(format!(
                "{frame}: camera: no ray passes through pixel {}; its focal length, principal point or distortion is singular",
                size * share
            )));
        }
    }
    Ok(())
}

fn validate_depth(frame: &str, view: &TrainView) -> Result<()> {
    for (number, depth) in view.depth.iter().enumerate() {
        let [x, y] = depth.pixel;
        let range_ok = depth.range_m.is_finite() && depth.range_m > 0.0;
        if !(x.is_finite() && y.is_finite() && range_ok) {
            return Err(Error::invalid(format!(
                "{frame}: depth {number} at ({x}, {y}) with range {} m is not finite and positive",
                depth.range_m
            )));
        }
        if !(depth.weight.is_finite() && depth.weight > 0.0) {
            return Err(Error::invalid(format!(
                "{frame}: depth {number} has weight {}, which is not finite and positive",
                depth.weight
            )));
        }
    }
    Ok(())
}

/// Checks a bounded scene: views, box and backdrop.
pub(super) fn validate_bounded(input: &BoundedInput) -> Result<()> {
    let (low, high) = (input.low_m, input.high_m);
    validate_views("scene", &input.views)?;
    require_foreground("scene", &input.views)?;
    if !(low.is_finite() && high.is_finite() && low.cmplt(high).all()) {
        return Err(Error::invalid(format!(
            "scene: the box from {low} to {high} is empty or not finite"
        )));
    }
    require_seen("scene", &input.views, low, high)?;
    if !input.backdrop.iter().all(|c| (0.0..=1.0).contains(c)) {
        return Err(Error::invalid(format!(
            "scene: backdrop {:?} must lie in 0..1",
            input.backdrop
        )));
    }
    Ok(())
}

/// Checks points that seed the field.
pub(super) fn validate_points(kind: &str, field: &str, points: &[[f32; 3]]) -> Result<()> {
    match points.iter().position(|p| !p.iter().all(|c| c.is_finite())) {
        Some(number) => Err(Error::invalid(format!(
            "{kind}: {field}[{number}] is not finite"
        ))),
        None => match points
            .iter()
            .position(|p| Vec3::from(*p).length() > FAR_M as f32)
        {
            Some(number) => Err(Error::invalid(format!(
                "{kind}: {field}[{number}] is more than {FAR_M:.0} m from the local origin"
            ))),
            None => Ok(()),
        },
    }
}

/// Every beam has a length, and one of `view_count` views.
pub(super) fn validate_beams(kind: &str, beams: &[LidarBeam], view_count: usize) -> Result<()> {
    let wrong = beams.iter().position(|beam| {
        let way = Vec3::from(beam.return_m) - Vec3::from(beam.origin_m);
        let length = way.length();
        !(length.is_finite() && length > 0.0) || beam.view as usize >= view_count
    });
    match wrong {
        Some(number) => Err(Error::invalid(format!(
            "{kind}: beams[{number}] must have finite, different ends and the index of a view"
        ))),
        None => Ok(()),
    }
}

/// Checks the figures that a field is built from; `kind` names the job in messages.
pub(super) fn validate_preset(kind: &str, preset: &TrainPreset) -> Result<()> {
    let bad = |what: String| Err(Error::invalid(format!("{kind}: preset: {what}")));
    let positive = |x: &f32| x.is_finite() && *x > 0.0;
    if preset.voxels_m.is_empty() || !preset.voxels_m.iter().all(positive) {
        return bad(format!("voxels_m {:?} must be positive", preset.voxels_m));
    }
    if preset.level_reach_m.len() != preset.voxels_m.len() {
        return bad("level_reach_m must have one entry per level".to_owned());
    }
    if !ColorMlp::WIDTHS.contains(&preset.mlp_width) {
        return bad(format!("mlp_width {} has no kernel", preset.mlp_width));
    }
    if preset.steps == 0 || preset.mix.pixel_rays == 0 {
        return bad("steps and mix.pixel_rays must not be 0".to_owned());
    }
    if !(preset.alpha_init > 0.0 && preset.alpha_init < 1.0) {
        return bad(format!(
            "alpha_init {} must lie between 0 and 1",
            preset.alpha_init
        ));
    }
    Ok(())
}

/// Refuses a field whose first `levels` levels would need more than the preset's memory if every brick were stored, before any is.
pub(super) fn require_memory(
    what: &'static str,
    field: &Field,
    levels: usize,
    preset: &TrainPreset,
) -> Result<()> {
    let bricks = field.levels.iter().take(levels);
    let bricks: u64 = bricks
        .map(|level| level.bricks_per_axis().as_u64vec3().element_product())
        .sum();
    if bricks * BRICK_BYTES > preset.memory_bytes {
        return Err(Error::OutOfMemory {
            what,
            needed_bytes: bricks * BRICK_BYTES,
            available_bytes: preset.memory_bytes,
        });
    }
    Ok(())
}

/// Refuses a box of which no training image shows anything.
pub(super) fn require_seen(
    kind: &str,
    views: &[TrainView],
    low_m: DVec3,
    high_m: DVec3,
) -> Result<()> {
    let at = |number: u32| {
        let step = DVec3::new(
            f64::from(number % BOX_POINTS),
            f64::from(number / BOX_POINTS % BOX_POINTS),
            f64::from(number / BOX_POINTS / BOX_POINTS),
        );
        low_m + (high_m - low_m) * step / f64::from(BOX_POINTS - 1)
    };
    let seen = |view: &TrainView| {
        let camera_from_local = view.local_from_camera.inverse();
        let size = DVec2::new(f64::from(view.camera.width), f64::from(view.camera.height));
        (0..BOX_POINTS.pow(3)).any(|number| {
            let pixel = view.camera.project(camera_from_local.point(at(number)));
            pixel.is_some_and(|p| p.cmpge(DVec2::ZERO).all() && p.cmplt(size).all())
        })
    };
    let mut train = views.iter().filter(|view| view.split == Split::Train);
    if train.any(seen) {
        Ok(())
    } else {
        Err(Error::invalid(format!(
            "{kind}: no training camera sees the box from {low_m} to {high_m}"
        )))
    }
}

/// Refuses views none of whose training pixels shows the object or scene itself.
pub(super) fn require_foreground(kind: &str, views: &[TrainView]) -> Result<()> {
    let mut train = views.iter().filter(|view| view.split == Split::Train);
    if train.any(|view| view.labels.contains(&PixelLabel::Foreground)) {
        Ok(())
    } else {
        Err(Error::invalid(format!(
            "{kind}: no ray is left, no training view has a pixel labelled foreground"
        )))
    }
}
