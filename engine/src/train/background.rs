//! Fits a background to a drive.

use glam::{DVec3, UVec3, Vec3};
use rayon::prelude::*;

use super::control::{Progress, Stage, TrainControl};
use super::dense_box::dense_box;
use super::fit::{fit, measured};
use super::free_space::{FreeSpace, Visibility};
use super::input::{BackgroundInput, Trained};
use super::preset::TrainPreset;
use super::refine::{Urgency, field_bytes};
use super::sampler::Sampler;
use super::seed::{CELL_VOXELS, CellSet, seed_density, store_around_points};
use super::survey::survey;
use super::validate::{
    require_foreground, validate_beams, validate_points, validate_preset, validate_views,
};
use crate::backend::Backend;
use crate::field::{ColorMlp, DensityActivation, Field, Lattice, Occupancy, SkyGrid, SkyMap};
use crate::scene::Draws;
use crate::view::Split;
use crate::{Error, Result};

/// Room below the lowest return and above the highest camera, in metres: returns end where the beams do, houses of six floors do
/// not. What lies above the box only the sky map can show, without parallax.
const BELOW_M: f64 = 1.0;
const ABOVE_M: f64 = 24.0;
/// Returns outside these quantiles do not widen the box.
const EXTENT_QUANTILE: f64 = 0.002;
/// Room beyond the farthest returns: scanners end before streets do.
const BEYOND_M: f64 = 40.0;
/// Edge of the cubes that free space is judged in, in metres.
const CUBE_M: f32 = 0.8;
/// Headings x elevations of the sky's grids: 5.6 degrees for what was never seen, 0.35 for what lies beyond the box.
const SKY_GRIDS: [(u32, u32); 2] = [(64, 32), (1024, 512)];

/// Trains a background field on the views whose split is `Train`, on a backend's device, and measures it on the held-out ones.
///
/// # Errors
/// [`Error::Invalid`] naming frame and field before any step, [`Error::OutOfMemory`] if the coarse levels alone exceed the
/// preset's bound, [`Error::Diverged`] and [`Error::Cancelled`].
pub fn train_background(
    input: &BackgroundInput,
    preset: &TrainPreset,
    seed: u64,
    backend: &dyn Backend,
    control: &dyn TrainControl,
) -> Result<Trained> {
    validate_preset("background", preset)?;
    validate_views("background", &input.views)?;
    require_foreground("background", &input.views)?;
    validate_points("background", "lidar_points", &input.lidar_points)?;
    validate_beams("background", &input.beams, input.views.len())?;
    if input.ego_path.is_empty() || !input.ego_path.iter().all(|p| p.is_finite()) {
        return Err(Error::invalid(
            "background: ego_path must be finite and not empty",
        ));
    }
    control.progress(Progress {
        stage: Stage::Prepare,
        step: 0,
        step_count: preset.steps,
        psnr_train: None,
    });
    let path: Vec<Vec3> = input.ego_path.iter().map(|p| p.as_vec3()).collect();
    let reach_m = &preset.level_reach_m;
    // What is near the path is near some camera: the largest on the images.
    let urgency = |p: Vec3, level: usize| {
        let distances = path.iter().map(|at| at.distance_squared(p));
        let nearest = distances.fold(f32::INFINITY, f32::min);
        (nearest < reach_m[level] * reach_m[level]).then_some(nearest)
    };
    let field = prepare(input, preset, seed, &urgency)?;
    let sampler = Sampler::whole_images(&input.views, &input.beams, seed);
    let (field, run) = fit(field, &sampler, preset, &urgency, backend, control)?;
    Ok(measured(field, run, &input.views, None, control))
}

fn prepare(
    input: &BackgroundInput,
    preset: &TrainPreset,
    seed: u64,
    urgency: Urgency<'_>,
) -> Result<Field> {
    if preset.options.dense_voxels > 0 {
        return prepare_dense(input, preset, seed);
    }
    let (low, high) = bounds(input, preset.box_reach_m);
    let mut field = empty_field(low, high, preset, seed)?;
    field.sky = Some(sky_map());
    let points: Vec<Vec3> = input.lidar_points.iter().map(|p| Vec3::from(*p)).collect();
    let near = CellSet::around_points(&field, &points);
    let free = FreeSpace::new(&input.views);
    let possible = possible_cubes(&free, low, high);
    // The coarsest level wherever something may be, so that it can be found in few samples; finer ones at returns.
    let coarsest = &mut field.levels[0];
    for cube in &possible {
        for corner in 0..8 {
            let step = Vec3::new(
                (corner & 1) as f32,
                (corner >> 1 & 1) as f32,
                (corner >> 2) as f32,
            );
            if let Some(at) = coarsest.brick_at(*cube + step * (CUBE_M + coarsest.voxel_m())) {
                coarsest.allocate(at);
            }
        }
    }
    let needed = field_bytes(&field);
    if needed > preset.memory_bytes {
        return Err(Error::OutOfMemory {
            what: "the background's coarse voxels",
            needed_bytes: needed,
            available_bytes: preset.memory_bytes,
        });
    }
    store_around_points(&mut field, &points, preset.memory_bytes, urgency);
    seed_density(&mut field, &points, preset.seed_sigma);
    let cubes = CellSet::of_cubes(&field, &possible, CUBE_M);
    field.occupancy = survey(&field, preset.step_voxels, |centre, _| {
        near.contains(centre) || cubes.contains(centre)
    });
    Ok(field)
}

/// One level with every brick of a flat box; what the views prove to be free is only marked so.
fn prepare_dense(input: &BackgroundInput, preset: &TrainPreset, seed: u64) -> Result<Field> {
    let (low, high, voxel_m) = dense_box(preset, |reach_m| bounds(input, reach_m))?;
    let preset = TrainPreset {
        voxels_m: vec![voxel_m],
        ..preset.clone()
    };
    let mut field = empty_field(low, high, &preset, seed)?;
    field.sky = Some(sky_map());
    for level in &mut field.levels {
        level.allocate_all();
    }
    let points: Vec<Vec3> = input.lidar_points.iter().map(|p| Vec3::from(*p)).collect();
    seed_density(&mut field, &points, preset.seed_sigma);
    let near = CellSet::around_points(&field, &points);
    let possible = possible_cubes(&FreeSpace::new(&input.views), low, high);
    let cubes = CellSet::of_cubes(&field, &possible, CUBE_M);
    field.occupancy = survey(&field, preset.step_voxels, |centre, _| {
        near.contains(centre) || cubes.contains(centre)
    });
    Ok(field)
}

pub(super) fn sky_map() -> SkyMap {
    let grids = SKY_GRIDS.map(|(width, height)| SkyGrid::new(width, height));
    SkyMap::new(grids.to_vec())
}

/// A field without bricks over the box from `low` to `high`.
pub(super) fn empty_field(low: Vec3, high: Vec3, preset: &TrainPreset, seed: u64) -> Result<Field> {
    let finest = preset.voxels_m.last().copied().unwrap_or(0.0);
    let too_large = || {
        Error::invalid(format!(
            "a box of {:.0} m is too large for voxels of {finest} m",
            (high - low).max_element()
        ))
    };
    let level = |voxel_m: &f32| Lattice::new(*voxel_m, low, high - low).ok_or_else(too_large);
    let mut draws = Draws::new(seed, u64::MAX, 0);
    Ok(Field {
        bounds_m: (low, high),
        levels: preset.voxels_m.iter().map(level).collect::<Result<_>>()?,
        activation: DensityActivation::from_alpha(preset.alpha_init, finest),
        mlp: ColorMlp::new(preset.mlp_width, || draws.unit()),
        sky: None,
        occupancy: Occupancy::new(finest * CELL_VOXELS, low, high - low).ok_or_else(too_large)?,
        step_growth: preset.step_growth,
    })
}

/// The box: the path's surroundings, cut to what LiDAR reached where there is LiDAR.
fn bounds(input: &BackgroundInput, reach_m: f64) -> (Vec3, Vec3) {
    let views = input.views.iter().filter(|view| view.split == Split::Train);
    let cameras = views.map(|view| view.local_from_camera.translation_m);
    let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    for p in cameras.chain(input.ego_path.iter().copied()) {
        low = low.min(p);
        high = high.max(p);
    }
    let mut reach_low = low - DVec3::new(reach_m, reach_m, 4.0);
    let mut reach_high = high + DVec3::new(reach_m, reach_m, ABOVE_M);
    if input.lidar_points.len() >= 100 {
        let (first, last) = extent(&input.lidar_points);
        let margin = DVec3::new(BEYOND_M, BEYOND_M, 0.0);
        reach_low = reach_low
            .max(first - margin - DVec3::Z * BELOW_M)
            .min(low - 1.0);
        let top = DVec3::new(last.x + BEYOND_M, last.y + BEYOND_M, f64::INFINITY);
        reach_high = reach_high.min(top).max(high + 1.0);
    }
    (reach_low.as_vec3(), reach_high.as_vec3())
}

fn extent(points: &[[f32; 3]]) -> (DVec3, DVec3) {
    let (mut low, mut high) = (DVec3::ZERO, DVec3::ZERO);
    for axis in 0..3 {
        let mut values: Vec<f32> = points.iter().map(|p| p[axis]).collect();
        values.sort_by(f32::total_cmp);
        let cut = (values.len() as f64 * EXTENT_QUANTILE) as usize;
        low[axis] = f64::from(values[cut]);
        high[axis] = f64::from(values[values.len() - 1 - cut]);
    }
    (low, high)
}

/// Lower corners of the cubes that some training view sees and none proves to be free.
fn possible_cubes(free: &FreeSpace, low: Vec3, high: Vec3) -> Vec<Vec3> {
    let cubes = ((high - low) / CUBE_M).ceil().as_uvec3();
    (0..cubes.element_product())
        .into_par_iter()
        .with_min_len(1024)
        .filter_map(|number| {
            let cube = UVec3::new(
                number % cubes.x,
                number / cubes.x % cubes.y,
                number / (cubes.x * cubes.y),
            );
            let corner = low + cube.as_vec3() * CUBE_M;
            let seen = free.judge(corner + CUBE_M / 2.0, CUBE_M) == Visibility::Possible;
            seen.then_some(corner)
        })
        .collect()
}
