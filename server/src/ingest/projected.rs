//! LiDAR returns, and what stands in for them, as a camera sees them at a frame's own time, without those that something nearer hides.

use backlot_engine::camera::{Camera, Rigid};
use backlot_engine::view::DepthSource;
use glam::{DVec2, DVec3};

use super::lidar::{Owner, WorldReturn};
use crate::domain::drive_log::Track;

/// A return in one image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ProjectedReturn {
    /// Continuous pixel position inside the image.
    pub pixel: DVec2,
    /// Euclidean distance from the camera in metres.
    pub range_m: f64,
    /// World position at the frame's time: returns on an object have moved with it.
    pub world_m: DVec3,
    /// Where it was measured from in the world: the scanner at its own time, or the camera.
    pub origin_m: DVec3,
    pub owner: Option<Owner>,
    /// Hidden from the camera by a nearer return: the LiDAR sits elsewhere and sees past edges.
    pub occluded: bool,
    pub source: DepthSource,
    /// Weight of its depth loss relative to a LiDAR return's.
    pub weight: f32,
}

impl ProjectedReturn {
    /// The least distance that it proves.
    pub(crate) fn proven_m(&self) -> f64 {
        let slack = self.source.slack().unwrap_or(0.0);
        self.range_m * (1.0 - f64::from(slack))
    }
}

/// A nearer return hides a farther one if they are this far apart: a fraction of the range and metres.
const HIDES_FRACTION: f64 = 0.05;
const HIDES_M: f64 = 0.3;
/// Half the window in radians in which returns count as neighbours: beams are 0.4 degrees apart, columns 0.1 to 0.2.
const WINDOW_X_RAD: f64 = 0.004;
const WINDOW_Y_RAD: f64 = 0.012;

/// Projects returns into an image taken at `timestamp_ns`.
pub(crate) fn project_returns(
    returns: &[WorldReturn],
    tracks: &[Track],
    camera: &Camera,
    world_from_camera: &Rigid,
    timestamp_ns: i64,
) -> Vec<ProjectedReturn> {
    let camera_from_world = world_from_camera.inverse();
    let poses: Vec<Option<Rigid>> = tracks.iter().map(|t| t.at(timestamp_ns)).collect();
    let size = DVec2::new(f64::from(camera.width), f64::from(camera.height));
    let mut projected: Vec<ProjectedReturn> = returns
        .iter()
        .filter_map(|r| {
            let world_m = match r.owner {
                Some(owner) => poses[owner.track]?.point(owner.cuboid_m),
                None => r.world_m,
            };
            let camera_m = camera_from_world.point(world_m);
            let pixel = camera.project(camera_m)?;
            let inside = pixel.cmpge(DVec2::ZERO).all() && pixel.cmplt(size).all();
            inside.then_some(ProjectedReturn {
                pixel,
                range_m: camera_m.length(),
                world_m,
                origin_m: r.origin_m,
                owner: r.owner,
                occluded: false,
                source: DepthSource::Lidar,
                weight: 1.0,
            })
        })
        .collect();
    mark_occluded(&mut projected, camera, 0.0);
    projected
}

/// A return is hidden if clearly nearer returns lie around it: above and below within the window. On ground that rises
/// in the image away from the camera the returns above are farther, so it never hides itself. The window is that of a scanner,
/// and at least `least_px` each way.
pub(super) fn mark_occluded(returns: &mut [ProjectedReturn], camera: &Camera, least_px: f64) {
    let window = camera.focal_px * DVec2::new(WINDOW_X_RAD, WINDOW_Y_RAD);
    let window = window.max(DVec2::splat(least_px.max(1.5)));
    let cells = Cells::new(returns, window, camera);
    for i in 0..returns.len() {
        let here = returns[i];
        let limit_m = here.range_m * (1.0 - HIDES_FRACTION) - HIDES_M;
        let (mut above, mut below) = (false, false);
        cells.visit_around(here.pixel, |j| {
            let offset = returns[j].pixel - here.pixel;
            if returns[j].range_m < limit_m && offset.abs().cmple(window).all() {
                above |= offset.y <= 0.0;
                below |= offset.y >= 0.0;
            }
        });
        returns[i].occluded = above && below;
    }
}

/// Returns sorted into cells of the window's size.
struct Cells {
    cell: DVec2,
    columns: usize,
    rows: usize,
    /// Start of each cell in `members`, one more than there are cells.
    starts: Vec<usize>,
    members: Vec<usize>,
}

impl Cells {
    fn new(returns: &[ProjectedReturn], cell: DVec2, camera: &Camera) -> Self {
        let columns = (f64::from(camera.width) / cell.x).ceil() as usize;
        let rows = (f64::from(camera.height) / cell.y).ceil() as usize;
        let mut cells = Self {
            cell,
            columns,
            rows,
            starts: vec![0; columns * rows + 1],
            members: vec![0; returns.len()],
        };
        for r in returns {
            let (x, y) = cells.at(r.pixel);
            cells.starts[y * columns + x + 1] += 1;
        }
        for i in 1..cells.starts.len() {
            cells.starts[i] += cells.starts[i - 1];
        }
        let mut next = cells.starts.clone();
        for (i, r) in returns.iter().enumerate() {
            let (x, y) = cells.at(r.pixel);
            let slot = &mut next[y * columns + x];
            cells.members[*slot] = i;
            *slot += 1;
        }
        cells
    }

    fn at(&self, pixel: DVec2) -> (usize, usize) {
        let at = pixel / self.cell;
        (
            (at.x as usize).min(self.columns - 1),
            (at.y as usize).min(self.rows - 1),
        )
    }

    /// Visits the members of the cell of `pixel` and its eight neighbours.
    fn visit_around(&self, pixel: DVec2, mut visit: impl FnMut(usize)) {
        let (x, y) = self.at(pixel);
        for row in y.saturating_sub(1)..(y + 2).min(self.rows) {
            let first = row * self.columns + x.saturating_sub(1);
            let last = row * self.columns + (x + 1).min(self.columns - 1);
            for &member in &self.members[self.starts[first]..self.starts[last + 1]] {
                visit(member);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use backlot_engine::camera::Distortion;

    fn camera() -> Camera {
        Camera {
            width: 600,
            height: 300,
            focal_px: DVec2::splat(500.0),
            principal_px: DVec2::new(300.0, 150.0),
            distortion: Distortion::None,
        }
    }

    /// Projects points given in the camera frame.
    fn project(points: impl IntoIterator<Item = DVec3>) -> Vec<ProjectedReturn> {
        let returns: Vec<_> = points
            .into_iter()
            .map(|world_m| WorldReturn {
                world_m,
                origin_m: DVec3::ZERO,
                owner: None,
            })
            .collect();
        project_returns(&returns, &[], &camera(), &Rigid::IDENTITY, 0)
    }

    #[test]
    fn returns_behind_a_wall_are_occluded_and_the_wall_is_not() {
        let grid = |z: f64, half: i32| {
            (-half..=half).flat_map(move |i| {
                (-half..=half)
                    .map(move |j| DVec3::new(f64::from(i) * 0.002 * z, f64::from(j) * 0.006 * z, z))
            })
        };
        let projected = project(grid(10.0, 10).chain(grid(20.03, 6)));
        for r in projected {
            assert_eq!(r.occluded, r.range_m > 15.0, "{r:?}");
        }
    }

    #[test]
    fn flat_ground_does_not_hide_itself() {
        let ground = (0..40).flat_map(|beam| {
            let z = 1.7 / (0.02 + 0.007 * f64::from(beam));
            (-50..50).map(move |i| DVec3::new(f64::from(i) * 0.003 * z, 1.7, z))
        });
        let projected = project(ground);
        assert!(projected.len() > 1_000);
        assert!(projected.iter().all(|r| !r.occluded));
    }

    #[test]
    fn range_is_euclidean() {
        let projected = project([DVec3::new(3.0, 0.0, 10.0)]);
        assert!((projected[0].range_m - 109f64.sqrt()).abs() < 1e-12);
        assert!((projected[0].pixel - DVec2::new(450.0, 150.0)).length() < 1e-9);
    }
}
