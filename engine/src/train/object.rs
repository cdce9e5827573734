//! Fits an object in the frame of its cuboid.

use glam::{DVec3, Vec3};

use super::background::empty_field;
use super::control::{Progress, Stage, TrainControl};
use super::fit::{fit, measured};
use super::input::{ObjectInput, Trained};
use super::preset::TrainPreset;
use super::sampler::Sampler;
use super::seed::seed_density;
use super::survey::survey;
use super::validate::{
    require_foreground, require_memory, validate_points, validate_preset, validate_views,
};
use crate::backend::Backend;
use crate::field::Field;
use crate::{Error, Result};

/// Room around the annotated cuboid: a twentieth of its size, at least 0.1 m, for annotation error, mirrors and antennas.
/// Rays through this padded box are what the rectified loss sees.
const PADDING: f64 = 0.05;
const PADDING_MIN_M: f64 = 0.1;
/// Largest object, in metres.
const SIZE_MAX_M: f64 = 40.0;
/// Share of mirrored rays for a symmetric object.
const MIRROR_SHARE: f64 = 0.5;

/// Half extents in metres of the box that holds an object of these full extents.
pub fn padded_half_m(size_m: DVec3) -> DVec3 {
    size_m / 2.0 + (size_m * PADDING).max(DVec3::splat(PADDING_MIN_M))
}

/// Trains an object field on the views whose split is `Train`, on a backend's device, and measures it on the held-out ones.
///
/// # Errors
/// [`Error::Invalid`] naming frame and field before any step, also if no camera sees the cuboid;
/// [`Error::OutOfMemory`], [`Error::Diverged`] and [`Error::Cancelled`].
pub fn train_object(
    input: &ObjectInput,
    preset: &TrainPreset,
    seed: u64,
    backend: &dyn Backend,
    control: &dyn TrainControl,
) -> Result<Trained> {
    validate_preset("object", preset)?;
    validate_views("object", &input.views)?;
    require_foreground("object", &input.views)?;
    validate_points("object", "lidar_points", &input.lidar_points)?;
    let size_ok = input.size_m.is_finite()
        && input.size_m.min_element() > 0.0
        && input.size_m.max_element() <= SIZE_MAX_M;
    if !size_ok {
        return Err(Error::invalid(format!(
            "object: size_m {} must be positive and at most {SIZE_MAX_M} m",
            input.size_m
        )));
    }
    let half_m = padded_half_m(input.size_m);
    let sampler = Sampler::around_cuboid(&input.views, half_m, seed);
    if sampler.view_count() == 0 {
        return Err(Error::invalid(
            "object: no training camera sees the whole cuboid",
        ));
    }
    control.progress(Progress {
        stage: Stage::Prepare,
        step: 0,
        step_count: preset.steps,
        psnr_train: None,
    });
    let mut preset = preset.clone();
    preset.mix.mirror_share = if input.symmetric { MIRROR_SHARE } else { 0.0 };
    let field = prepare(input, half_m, &preset, seed)?;
    let (field, run) = fit(
        field,
        &sampler,
        &preset,
        &|_, _| Some(0.0),
        backend,
        control,
    )?;
    Ok(measured(field, run, &input.views, None, control))
}

/// All bricks of the box, and density at the returns. The box is small, so nothing is left out.
fn prepare(input: &ObjectInput, half_m: DVec3, preset: &TrainPreset, seed: u64) -> Result<Field> {
    let mut field = empty_field(-half_m.as_vec3(), half_m.as_vec3(), preset, seed)?;
    require_memory("the object's voxels", &field, field.levels.len(), preset)?;
    for level in &mut field.levels {
        level.allocate_all();
    }
    let mut points: Vec<Vec3> = input.lidar_points.iter().map(|p| Vec3::from(*p)).collect();
    if input.symmetric {
        points.extend_from_within(..);
        let returns = input.lidar_points.len();
        points[returns..].iter_mut().for_each(|p| p.y = -p.y);
    }
    seed_density(&mut field, &points, preset.seed_sigma);
    field.occupancy = survey(&field, preset.step_voxels, |_, _| true);
    Ok(field)
}
