//! Fits a bounded scene photographed from outside in front of a plain colour, as the NeRF-synthetic scenes are.

use glam::{DMat3, DVec3, UVec3, Vec3};

use super::background::empty_field;
use super::control::{Progress, Stage, TrainControl};
use super::fit::{fit, measured};
use super::input::{BoundedInput, Trained};
use super::preset::TrainPreset;
use super::sampler::Sampler;
use super::survey::survey;
use super::validate::{require_memory, validate_bounded, validate_preset};
use crate::backend::Backend;
use crate::camera::Camera;
use crate::field::Field;
use crate::view::{Split, TrainView};
use crate::{Error, Result};

/// Share of the training cameras that must see a point of the box. A scene is in view of nearly all of its cameras.
const SEEN_SHARE: f64 = 0.9;
/// Cells per axis of the grid on which visibility is counted.
const CELLS: u32 = 48;

/// The box that the training cameras look at: every point that nearly all of them see.
///
/// # Errors
/// [`Error::Invalid`] if the cameras share no view.
pub fn seen_box(views: &[TrainView]) -> Result<(DVec3, DVec3)> {
    let train: Vec<&TrainView> = views.iter().filter(|v| v.split == Split::Train).collect();
    let centre = nearest_to_axes(&train);
    let eyes = train.iter().map(|v| v.local_from_camera.translation_m);
    let mut distances: Vec<f64> = eyes.map(|eye| eye.distance(centre)).collect();
    distances.sort_by(f64::total_cmp);
    let reach = distances.get(distances.len() / 2).copied().unwrap_or(0.0);
    let needed = (train.len() as f64 * SEEN_SHARE).ceil() as usize;
    let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    let side = 2.0 * reach / f64::from(CELLS);
    for number in 0..CELLS.pow(3) {
        let cell = UVec3::new(
            number % CELLS,
            number / CELLS % CELLS,
            number / CELLS / CELLS,
        );
        let p = centre - reach + (cell.as_dvec3() + 0.5) * side;
        if train.iter().filter(|view| sees(view, p)).count() >= needed {
            low = low.min(p - side / 2.0);
            high = high.max(p + side / 2.0);
        }
    }
    if low.cmplt(high).all() {
        Ok((low, high))
    } else {
        Err(Error::invalid(
            "scene: the training cameras do not look at a common place; check the poses' convention",
        ))
    }
}

fn sees(view: &TrainView, p: DVec3) -> bool {
    let Camera { width, height, .. } = view.camera;
    let pixel = view
        .camera
        .project(view.local_from_camera.inverse().point(p));
    pixel.is_some_and(|q| {
        (0.0..f64::from(width)).contains(&q.x) && (0.0..f64::from(height)).contains(&q.y)
    })
}

/// The point with the least sum of squared distances to the optical axes.
pub(super) fn nearest_to_axes(views: &[&TrainView]) -> DVec3 {
    let (mut a, mut b) = (DMat3::ZERO, DVec3::ZERO);
    for view in views {
        let axis = view.local_from_camera.direction(DVec3::Z);
        let outer = DMat3::from_cols(axis * axis.x, axis * axis.y, axis * axis.z);
        let across = DMat3::IDENTITY - outer;
        a += across;
        b += across * view.local_from_camera.translation_m;
    }
    // Parallel axes have no nearest point; a little of the identity then keeps it near the cameras.
    let damped = a + DMat3::from_diagonal(DVec3::splat(1e-6 * views.len() as f64));
    damped.inverse() * b
}

/// Trains a field on the views whose split is `Train`, on a backend's device, and measures it on the held-out ones.
///
/// # Errors
/// [`Error::Invalid`] naming frame and field before any step, [`Error::OutOfMemory`], [`Error::Diverged`] and
/// [`Error::Cancelled`].
pub fn train_bounded(
    input: &BoundedInput,
    preset: &TrainPreset,
    seed: u64,
    backend: &dyn Backend,
    control: &dyn TrainControl,
) -> Result<Trained> {
    validate_preset("scene", preset)?;
    validate_bounded(input)?;
    control.progress(Progress {
        stage: Stage::Prepare,
        step: 0,
        step_count: preset.steps,
        psnr_train: None,
    });
    let sampler = Sampler::before(&input.views, input.backdrop, seed);
    let field = prepare(input, preset, seed)?;
    let (field, run) = fit(field, &sampler, preset, &|_, _| Some(0.0), backend, control)?;
    Ok(measured(
        field,
        run,
        &input.views,
        Some(input.backdrop),
        control,
    ))
}

/// The coarsest level everywhere; surveys store finer bricks where something turns up.
fn prepare(input: &BoundedInput, preset: &TrainPreset, seed: u64) -> Result<Field> {
    let (low, high) = (input.low_m.as_vec3(), input.high_m.as_vec3());
    let mut field = empty_field(low, high, preset, seed)?;
    require_memory("the scene's voxels", &field, 1, preset)?;
    if let Some(level) = field.levels.first_mut() {
        level.allocate_all();
    }
    field.occupancy = survey(&field, preset.step_voxels, |_: Vec3, _| true);
    Ok(field)
}

#[cfg(test)]
mod tests {
    use glam::{DQuat, DVec2};

    use super::*;
    use crate::camera::{Distortion, Rigid};
    use crate::view::PixelLabel;

    /// Cameras on a sphere of this radius around `centre`, looking at it or, if `away`, away from it.
    fn cameras(centre: DVec3, radius: f64, away: bool) -> Vec<TrainView> {
        let directions = (0..24).map(|i| {
            let (turn, height) = (f64::from(i) * 2.4, f64::from(i) / 24.0 - 0.3);
            let across = (1.0 - height * height).sqrt();
            DVec3::new(across * turn.cos(), across * turn.sin(), height)
        });
        directions
            .map(|out| {
                let forward = if away { out } else { -out };
                let right = forward.cross(DVec3::Z).normalize();
                let axes = DMat3::from_cols(right, forward.cross(right), forward);
                TrainView {
                    frame_index: 0,
                    camera: Camera {
                        width: 8,
                        height: 8,
                        focal_px: DVec2::splat(8.0),
                        principal_px: DVec2::splat(4.0),
                        distortion: Distortion::None,
                    },
                    local_from_camera: Rigid::new(
                        DQuat::from_mat3(&axes).normalize(),
                        centre + out * radius,
                    ),
                    rgb: vec![0; 192],
                    labels: vec![PixelLabel::Foreground; 64],
                    depth: Vec::new(),
                    split: Split::Train,
                }
            })
            .collect()
    }

    #[test]
    fn the_box_holds_what_nearly_all_cameras_see_wherever_the_scene_is() {
        let centre = DVec3::new(3.0, -7.0, 2.0);
        let (low, high) = seen_box(&cameras(centre, 4.0, false)).unwrap();
        // Half the view's width at the centre: 4 m * 4 px / 8 px. The common part is a little more than that ball.
        let half = (high - low) / 2.0;
        assert!(((low + high) / 2.0).distance(centre) < 0.5, "{low} {high}");
        assert!(
            half.min_element() > 1.3 && half.max_element() < 2.9,
            "{half}"
        );
    }

    #[test]
    fn cameras_that_look_apart_share_no_box() {
        assert!(seen_box(&cameras(DVec3::ZERO, 4.0, true)).is_err());
    }
}
