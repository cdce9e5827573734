//! Free cells in the camera's view that suit a preset, by distance.

use super::collision::Occupied;
use super::composition::Stage;
use super::footprint::GroundPlane;
use super::preset::PlacementPreset;
use super::recipe::Recipe;
use super::road::Road;
use super::sight::clear_fraction;
use crate::camera::{Camera, Rigid};
use glam::{DVec2, DVec3};

/// Free cells as (distance from the camera in metres, cell), ascending.
#[derive(Debug, Default)]
pub(super) struct Places {
    cells: Vec<(f64, usize)>,
}

/// Cells around a cell over which its slope is taken: a car's length.
const SLOPE_REACH_M: f64 = 2.0;
/// Lateral distances from the ego's path at which a cut-in begins: a wheel on the line, or the lane beside.
const CUT_IN_LATERAL_M: (f64, f64) = (1.2, 3.0);
/// A car that stands for any object where the hidden places are looked for.
const COMMON_SIZE_M: DVec3 = DVec3::new(4.2, 1.8, 1.5);

impl Places {
    /// `fixed` are the originals that the environment holds.
    pub(super) fn new(
        stage: &Stage<'_>,
        recipe: &Recipe,
        camera: &Camera,
        local_from_camera: &Rigid,
        fixed: &[Occupied],
    ) -> Self {
        let region = stage.region;
        let road = Road::new(stage.recording);
        let camera_from_local = local_from_camera.inverse();
        let eye = local_from_camera.translation_m;
        let [near, far] = recipe.distance_m;
        let mut cells: Vec<(f64, usize)> = region
            .free_cells()
            .filter_map(|i| {
                let ground = region.centre(i).extend(region.ground_m[i]);
                let p = camera_from_local.point(ground);
                let distance = p.length();
                if distance < near || distance > far {
                    return None;
                }
                let pixel = camera.project(p)?;
                let inside = pixel.x >= 0.0 && pixel.x < f64::from(camera.width);
                inside.then_some((distance, i))
            })
            .collect();
        let suits = |cell: usize| {
            let at = region.centre(cell);
            let slope = || slope_at(stage, cell) >= recipe.min_slope;
            let lateral = || {
                let (low, high) = CUT_IN_LATERAL_M;
                (low..high).contains(&road.at(at).lateral_m.abs())
            };
            let hidden = || {
                let centre = at.extend(region.ground_m[cell] + 0.5 * COMMON_SIZE_M.z);
                let common = Occupied {
                    local_from_cuboid: Rigid::from_heading(road.at(at).heading_rad, centre),
                    size_m: COMMON_SIZE_M,
                };
                let clear = clear_fraction(eye, &common, fixed, region);
                (recipe.clear_fraction[0]..=recipe.clear_fraction[1]).contains(&clear)
            };
            (recipe.min_slope == 0.0 || slope())
                && (recipe.preset != PlacementPreset::CutIn || lateral())
                && (recipe.clear_fraction[1] >= 1.0 || hidden())
        };
        cells.retain(|(_, cell)| suits(*cell));
        cells.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        Self { cells }
    }

    /// The cells at distances in `near..=far`.
    pub(super) fn between(&self, near: f64, far: f64) -> &[(f64, usize)] {
        let first = self.cells.partition_point(|c| c.0 < near);
        let last = self.cells.partition_point(|c| c.0 <= far);
        &self.cells[first..last.max(first)]
    }
}

/// Slope of the free ground around a cell.
fn slope_at(stage: &Stage<'_>, cell: usize) -> f64 {
    let region = stage.region;
    let centre = region.centre(cell);
    let steps = libm::floor(SLOPE_REACH_M / region.cell_m) as i32;
    let around = (-steps..=steps).flat_map(|y| (-steps..=steps).map(move |x| (x, y)));
    let points: Vec<DVec3> = around
        .filter_map(|(x, y)| {
            let p = centre + DVec2::new(f64::from(x), f64::from(y)) * region.cell_m;
            let index = region.index_at(p)?;
            let free = region.cells[index] == super::valid_region::Cell::Free;
            free.then(|| region.centre(index).extend(region.ground_m[index]))
        })
        .collect();
    GroundPlane::fit(&points).map_or(0.0, |plane| plane.slope.length())
}
