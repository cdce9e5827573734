//! Ground heights from a density field, grown outwards from the driven path.
//!
//! The path is known to be road, so the search for the surface starts there and carries a prediction from cell to cell: a roof or a
//! wall is never taken for ground, because it steps away from the prediction, and small holes are bridged.

use std::collections::{HashMap, VecDeque};

use glam::{DVec2, DVec3};

use super::density::DensityField;
use super::footprint::GroundPlane;
use super::path::DrivenPath;
use super::region_builder::RegionConfig;
use super::valid_region::ValidRegion;

/// What growing found at a cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Found {
    /// Not reached.
    Nothing,
    Ground,
    /// No surface within the window; the height is the neighbours'.
    Hole(u8),
    /// A surface, but a step away from its neighbours or off the road's plane.
    Step,
}

/// Vertical optical depth at which the surface is said to start. Roads are seen at grazing angles, where this is half opaque.
const SURFACE_TAU: f64 = 0.1;
const PROBE_STEP_M: f64 = 0.025;
/// Half height of the window around the predicted height.
const WINDOW_M: f64 = 0.25;
/// Holes in the reconstruction narrower than this many cells are bridged.
const MAX_HOLE_CELLS: u8 = 2;
/// Search below a camera for the road: cameras of cars and trucks are 1 to 3 m high.
const CAMERA_HEIGHT_M: (f64, f64) = (0.4, 4.0);
/// A camera nods by so much on its way.
const AGREEMENT_M: f64 = 0.2;
/// Ahead of the last pose, the path's own height is trusted this far.
const SEED_AHEAD_M: usize = 10;
/// The road's plane is fitted to ground this near to the path: about its own lane.
const ROAD_PLANE_M: f64 = 2.5;
/// Of eight; a kerb or wall cell has at most five on the road's side.
const HEALING_NEIGHBOURS: usize = 6;
/// At the edge of what is looked at, where all that are looked at must be ground: along a kerb two of them are not.
const HEALING_AT_EDGE: usize = 5;

/// Fills `region.ground_m` and says what was found per cell; `None` if no road is found under the path.
pub(super) fn grow_ground(
    field: &dyn DensityField,
    path: &DrivenPath,
    config: &RegionConfig,
    region: &mut ValidRegion,
) -> Option<Vec<Found>> {
    let camera_height = camera_height(field, path)?;
    let mut found = vec![Found::Nothing; region.cells.len()];
    let mut queue = seed(field, path, camera_height, region, &mut found);
    while let Some(from) = queue.pop_front() {
        for to in neighbours(region, from, false) {
            if found[to] != Found::Nothing
                || !path.is_beside(region.centre(to), config.max_lateral_m)
            {
                continue;
            }
            let Some(predicted) = predict(region, path, &found, to) else {
                continue;
            };
            let surface = cell_surface(field, region, to, predicted);
            found[to] = match surface {
                Some(z) if (z - predicted).abs() <= config.max_step_m => Found::Ground,
                Some(_) => Found::Step,
                None => match found[from] {
                    Found::Hole(cells) => Found::Hole(cells + 1),
                    _ => Found::Hole(1),
                },
            };
            region.ground_m[to] = match found[to] {
                Found::Ground => surface.unwrap_or(predicted),
                _ => predicted,
            };
            let bridged = !matches!(found[to], Found::Hole(cells) if cells >= MAX_HOLE_CELLS);
            if found[to] != Found::Step && bridged {
                queue.push_back(to);
            }
        }
    }
    smooth(region, &found);
    reject_off_road(path, config, region, &mut found);
    heal(path, config, region, &mut found);
    Some(found)
}

/// Height of the cameras above the surface under the path on which most places agree. Where no camera looked, as before the first
/// frame's image begins or under the vehicle ahead, the field holds anything, and heights spread.
fn camera_height(field: &dyn DensityField, path: &DrivenPath) -> Option<f64> {
    let last = (path.driven + SEED_AHEAD_M).min(path.points().len());
    let heights = path.points()[..last].iter().filter_map(|p| {
        let (top, bottom) = (p.z - CAMERA_HEIGHT_M.0, p.z - CAMERA_HEIGHT_M.1);
        surface(field, p.truncate(), top, bottom).map(|z| p.z - z)
    });
    most_agreed(heights.collect())
}

/// Median of the most values within [`AGREEMENT_M`] of each other, the lower ones of equally many.
fn most_agreed(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    let within = |first: usize| {
        let limit = values[first] + AGREEMENT_M;
        values.partition_point(|v| *v <= limit) - first
    };
    let first = (0..values.len()).max_by_key(|i| (within(*i), std::cmp::Reverse(*i)))?;
    Some(values[first + within(first) / 2])
}

/// Marks the cells under the path whose surface is where the cameras' height says.
fn seed(
    field: &dyn DensityField,
    path: &DrivenPath,
    camera_height: f64,
    region: &mut ValidRegion,
    found: &mut [Found],
) -> VecDeque<usize> {
    let mut queue = VecDeque::new();
    let last = (path.driven + SEED_AHEAD_M).min(path.points().len());
    for p in &path.points()[..last] {
        let Some(cell) = region.index_at(p.truncate()) else {
            continue;
        };
        if found[cell] != Found::Nothing {
            continue;
        }
        if let Some(z) = cell_surface(field, region, cell, p.z - camera_height)
            && (z - (p.z - camera_height)).abs() < WINDOW_M * 0.8
        {
            region.ground_m[cell] = z;
            found[cell] = Found::Ground;
            queue.push_back(cell);
        }
    }
    queue
}

/// Mean height of the grounded cells around, or of the bridged ones if there is no other, each carried over to the cell along
/// the road's own slope: at a corner all that is known lies on one side.
fn predict(region: &ValidRegion, path: &DrivenPath, found: &[Found], cell: usize) -> Option<f64> {
    let centre = region.centre(cell);
    let slope = path.slope_beside(centre);
    let mean = |wanted: fn(Found) -> bool| {
        let (mut sum, mut count) = (0.0, 0.0);
        for n in neighbours(region, cell, true).filter(|n| wanted(found[*n])) {
            sum += region.ground_m[n] + slope.dot(centre - region.centre(n));
            count += 1.0;
        }
        (count > 0.0).then(|| sum / count)
    };
    mean(|f| f == Found::Ground).or_else(|| mean(|f| matches!(f, Found::Hole(_))))
}

/// Median of five probes in the cell; `None` unless three find a surface.
fn cell_surface(
    field: &dyn DensityField,
    region: &ValidRegion,
    cell: usize,
    predicted: f64,
) -> Option<f64> {
    let quarter = region.cell_m * 0.25;
    let centre = region.centre(cell);
    let offsets = [
        (0.0, 0.0),
        (1.0, 1.0),
        (1.0, -1.0),
        (-1.0, 1.0),
        (-1.0, -1.0),
    ];
    let mut heights: Vec<f64> = offsets
        .iter()
        .filter_map(|(x, y)| {
            let p = centre + DVec2::new(*x, *y) * quarter;
            surface(field, p, predicted + WINDOW_M, predicted - WINDOW_M)
        })
        .collect();
    heights.sort_by(f64::total_cmp);
    (heights.len() >= 3).then(|| heights[heights.len() / 2])
}

/// Height at which the optical depth from `top` downwards reaches [`SURFACE_TAU`].
fn surface(field: &dyn DensityField, p: DVec2, top: f64, bottom: f64) -> Option<f64> {
    let steps = libm::ceil((top - bottom) / PROBE_STEP_M) as i32;
    let mut tau = 0.0;
    for i in 0..steps {
        let z = top - f64::from(i) * PROBE_STEP_M;
        let step = field.sigma(p.extend(z - 0.5 * PROBE_STEP_M)) * PROBE_STEP_M;
        if tau + step >= SURFACE_TAU {
            return Some(z - PROBE_STEP_M * (SURFACE_TAU - tau) / step);
        }
        tau += step;
    }
    None
}

/// Indices around a cell: four, or eight with `diagonal`.
pub(super) fn neighbours(
    region: &ValidRegion,
    cell: usize,
    diagonal: bool,
) -> impl Iterator<Item = usize> + use<> {
    let (columns, rows) = (region.columns as i64, region.rows as i64);
    let (column, row) = (cell as i64 % columns, cell as i64 / columns);
    (-1..=1i64)
        .flat_map(|dy| (-1..=1i64).map(move |dx| (dx, dy)))
        .filter(move |(dx, dy)| (*dx != 0 || *dy != 0) && (diagonal || *dx == 0 || *dy == 0))
        .map(move |(dx, dy)| (column + dx, row + dy))
        .filter(move |(x, y)| (0..columns).contains(x) && (0..rows).contains(y))
        .map(move |(x, y)| (y * columns + x) as usize)
}

/// Replaces each ground height by the median of the grounded cells around it, itself included.
fn smooth(region: &mut ValidRegion, found: &[Found]) {
    let before = region.ground_m.clone();
    for cell in (0..found.len()).filter(|c| found[*c] == Found::Ground) {
        let mut heights: Vec<f64> = neighbours(region, cell, true)
            .chain([cell])
            .filter(|n| found[*n] == Found::Ground)
            .map(|n| before[n])
            .collect();
        heights.sort_by(f64::total_cmp);
        let middle = heights.len() / 2;
        region.ground_m[cell] = if heights.len() % 2 == 1 {
            heights[middle]
        } else {
            0.5 * (heights[middle - 1] + heights[middle])
        };
    }
}

/// Pavements and verges leave the plane of the road: limits the height off the plane fitted to the ground near the path.
fn reject_off_road(
    path: &DrivenPath,
    config: &RegionConfig,
    region: &ValidRegion,
    found: &mut [Found],
) {
    let mut planes: HashMap<usize, Option<GroundPlane>> = HashMap::new();
    let grounded = found.to_vec();
    for (cell, found) in found.iter_mut().enumerate() {
        if *found != Found::Ground {
            continue;
        }
        let centre = region.centre(cell);
        let beside = path.beside(centre);
        let plane = region.index_at(beside.foot).and_then(|foot| {
            *planes
                .entry(foot)
                .or_insert_with(|| road_plane(region, &grounded, foot))
        });
        let limit = config.max_step_m + config.off_plane * beside.distance_m;
        let off = plane.map_or(f64::INFINITY, |p| {
            (region.ground_m[cell] - p.height_at(centre)).abs()
        });
        if off > limit {
            *found = Found::Step;
        }
    }
}

/// Plane of the ground within [`ROAD_PLANE_M`] of a cell under the path.
fn road_plane(region: &ValidRegion, found: &[Found], foot: usize) -> Option<GroundPlane> {
    let reach = libm::ceil(ROAD_PLANE_M / region.cell_m) as i64;
    let (columns, rows) = (region.columns as i64, region.rows as i64);
    let (column, row) = (foot as i64 % columns, foot as i64 / columns);
    let around = (-reach..=reach).flat_map(|dy| (-reach..=reach).map(move |dx| (dx, dy)));
    let points: Vec<DVec3> = around
        .map(|(dx, dy)| (column + dx, row + dy))
        .filter(|(x, y)| (0..columns).contains(x) && (0..rows).contains(y))
        .map(|(x, y)| (y * columns + x) as usize)
        .filter(|cell| found[*cell] == Found::Ground)
        .map(|cell| region.centre(cell).extend(region.ground_m[cell]))
        .collect();
    GroundPlane::fit(&points)
}

/// A lone cell amid road that stepped or had no surface is an error of the field: it takes its neighbours' height.
fn heal(path: &DrivenPath, config: &RegionConfig, region: &mut ValidRegion, found: &mut [Found]) {
    let before = found.to_vec();
    for cell in 0..found.len() {
        if !matches!(before[cell], Found::Step | Found::Hole(_)) {
            continue;
        }
        let looked_at: Vec<usize> = neighbours(region, cell, true)
            .filter(|n| path.is_beside(region.centre(*n), config.max_lateral_m))
            .collect();
        let mut heights: Vec<f64> = looked_at
            .iter()
            .filter(|n| before[**n] == Found::Ground)
            .map(|n| region.ground_m[*n])
            .collect();
        let enough = HEALING_NEIGHBOURS.min(looked_at.len().max(HEALING_AT_EDGE));
        if heights.len() >= enough {
            heights.sort_by(f64::total_cmp);
            region.ground_m[cell] = heights[heights.len() / 2];
            found[cell] = Found::Ground;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_camera_height_is_that_on_which_most_places_agree() {
        // As recorded under a car that stopped in a queue: nothing was seen under its start nor under the vehicle ahead.
        let seen = [1.70, 1.62, 1.62, 1.65, 1.65, 1.65, 1.62, 1.62, 1.57];
        let unseen = [
            2.80, 2.50, 1.90, 2.00, 2.37, 2.35, 2.40, 2.42, 2.50, 2.35, 2.20, 2.17,
        ];
        let all: Vec<f64> = seen.iter().chain(&unseen).copied().collect();
        assert_eq!(most_agreed(all.clone()), Some(1.62));
        let mut sorted = all;
        sorted.sort_by(f64::total_cmp);
        assert!(
            sorted[sorted.len() / 2] > 1.85,
            "the median is off the road"
        );
        assert_eq!(most_agreed(vec![1.0, 2.0]), Some(1.0));
        assert_eq!(most_agreed(Vec::new()), None);
    }
}
