//! Fits a bounded scene photographed from outside in front of a plain colour, as the NeRF-synthetic scenes are.

use glam::{DMat3, DVec3, UVec3, Vec3};

use super::background::empty_field;
use super::control::{Progress, Stage, TrainControl};
use super::fit::{fit, measured};
use super::input::{BoundedInput, Trained};
use super::preset::TrainPreset;
use super::sampler::Sampler;
use super::survey::survey;
use super::validate::{
    require_foreground, require_memory, require_seen, validate_preset, validate_views,
};
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

/// Trains a field on the views whose split is `Train`, and measures it on the held-out ones.
///
/// # Errors
/// [`Error::Invalid`] naming frame and field before any step, [`Error::OutOfMemory`], [`Error::Diverged`] and
/// [`Error::Cancelled`].
pub fn train_bounded(
    input: &BoundedInput,
    preset: &TrainPreset,
    seed: u64,
    control: &dyn TrainControl,
) -> Result<Trained> {
    validate_preset("scene", preset)?;
    validate_views("scene", &input.views)?;
    require_foreground("scene", &input.views)?;
    let sound = input.low_m.is_finite()
        && input.high_m.is_finite()
        && input.low_m.cmplt(input.high_m).all();
    if !sound {
        return Err(Error::invalid(format!(
            "scene: the box from {} to {} is empty or not finite",
            input.low_m, input.high_m
        )));
    }
    require_seen("scene", &input.views, input.low_m, input.high_m)?;
    if !input.backdrop.iter().all(|c| (0.0..=1.0).contains(c)) {
        return Err(Error::invalid(format!(
            "scene: backdrop {:?} must lie in 0..1",
            input.backdrop
        )));
    }
    control.progress(Progress {
        stage: Stage::Prepare,
        step: 0,
        step_count: preset.steps,
        psnr_train: None,
    });
    let sampler = Sampler::before(&input.views, input.backdrop, seed);
    let field = prepare(input, preset, seed)?;
    let (field, run) = fit(field, &sampler, preset, &|_, _| true, control)?;
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
