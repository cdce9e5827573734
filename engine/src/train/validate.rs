//! Checks of training input before the first step.

use crate::view::{PixelLabel, Split, TrainView};
use crate::{Error, Result};

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
    }
    Ok(())
}

/// Checks points that seed the field.
pub(super) fn validate_points(kind: &str, field: &str, points: &[[f32; 3]]) -> Result<()> {
    match points.iter().position(|p| !p.iter().all(|c| c.is_finite())) {
        Some(number) => Err(Error::invalid(format!(
            "{kind}: {field}[{number}] is not finite"
        ))),
        None => Ok(()),
    }
}
