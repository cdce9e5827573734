//! Whether the space above the ground is clear: the paper's pillars (eq. 7), from the ground up (T7).

use glam::DVec2;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::density::DensityField;
use super::ground::Found;
use super::region_builder::RegionConfig;
use super::valid_region::ValidRegion;

/// Which pillars judge a cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Pillars {
    /// Any that holds the cell: things take their own cells and gaps narrower than a pillar, wherever the grid begins.
    AnyAround,
    /// The one of a fixed raster that holds it.
    Raster,
}

/// Density above one cell's ground in 1/m.
#[derive(Clone, Copy, Debug, Default)]
struct Column {
    max: f64,
    mean: f64,
}

const STEP_M: f64 = 0.1;
/// Samples per cell side.
const SAMPLES: u32 = 3;

/// Per cell, whether a pillar that judges it stays under both thresholds. Cells without ground are in no pillar.
pub(super) fn clear_cells(
    field: &dyn DensityField,
    config: &RegionConfig,
    region: &ValidRegion,
    found: &[Found],
) -> Vec<bool> {
    let columns: Vec<Option<Column>> = (0..found.len())
        .into_par_iter()
        .map(|cell| (found[cell] != Found::Nothing).then(|| column(field, config, region, cell)))
        .collect();
    let side = (libm::round(config.pillar_m / config.cell_m) as usize).max(1);
    let stride = match config.pillars {
        Pillars::AnyAround => 1,
        Pillars::Raster => side,
    };
    let mut clear = vec![false; found.len()];
    for first_row in (0..region.rows).step_by(stride) {
        for first_column in (0..region.columns).step_by(stride) {
            let cells: Vec<usize> = (first_row..(first_row + side).min(region.rows))
                .flat_map(|y| {
                    (first_column..(first_column + side).min(region.columns))
                        .map(move |x| y * region.columns + x)
                })
                .collect();
            // At the grid's far edges a sliding pillar would shrink, and judge less than a pillar.
            let whole = cells.len() == side * side || config.pillars == Pillars::Raster;
            if whole && is_clear(&columns, &cells, config) {
                cells.iter().for_each(|cell| clear[*cell] = true);
            }
        }
    }
    clear
}

fn is_clear(columns: &[Option<Column>], cells: &[usize], config: &RegionConfig) -> bool {
    let (mut max, mut sum, mut count) = (0.0f64, 0.0, 0.0);
    for column in cells.iter().filter_map(|cell| columns[*cell]) {
        max = max.max(column.max);
        sum += column.mean;
        count += 1.0;
    }
    count > 0.0 && max < config.max_sigma && sum / count < config.mean_sigma
}

fn column(
    field: &dyn DensityField,
    config: &RegionConfig,
    region: &ValidRegion,
    cell: usize,
) -> Column {
    let corner = region.centre(cell) - DVec2::splat(region.cell_m * 0.5);
    let ground = region.ground_m[cell];
    let height = config.pillar_to_m - config.pillar_from_m;
    let levels = libm::ceil(height / STEP_M) as u32;
    let (mut max, mut sum) = (0.0f64, 0.0);
    for i in 0..SAMPLES * SAMPLES {
        let at = |k: u32| (f64::from(k) + 0.5) / f64::from(SAMPLES) * region.cell_m;
        let p = corner + DVec2::new(at(i % SAMPLES), at(i / SAMPLES));
        for level in 0..levels {
            let up = config.pillar_from_m + (f64::from(level) + 0.5) / f64::from(levels) * height;
            let sigma = field.sigma(p.extend(ground + up));
            max = max.max(sigma);
            sum += sigma;
        }
    }
    Column {
        max,
        mean: sum / f64::from(levels * SAMPLES * SAMPLES),
    }
}
