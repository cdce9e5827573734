//! Space that the log proves to be empty, or never saw, before training starts.

use glam::{DVec3, Vec3};

use crate::camera::{Camera, Rigid};
use crate::view::{PixelLabel, Split, TrainView};

/// Edge of an image tile in pixels.
const TILE: u32 = 8;

/// Cubes this much farther than every return around them are hidden in a view, in metres: returns are sparse.
const HIDDEN_MARGIN_M: f64 = 2.0;

/// What a view proves about the directions of each image tile: free up to a range, and hidden beyond one.
#[derive(Debug)]
struct FreeTiles {
    camera: Camera,
    camera_from_local: Rigid,
    columns: u32,
    /// Metres; infinite where the tile is sky, 0 where nothing is known.
    free_m: Vec<f32>,
    /// Metres; infinite where there is no return.
    farthest_m: Vec<f32>,
}

/// Free space as the training views see it: up to the LiDAR returns or nearly up to the depth map, and everywhere along sky pixels.
#[derive(Debug)]
pub(super) struct FreeSpace {
    views: Vec<FreeTiles>,
}

/// What the views say about a cube of space.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Visibility {
    /// In no training image, or behind the returns in each.
    Unseen,
    /// In an image, and not proven to be free.
    Possible,
    /// Proven to be free.
    Free,
}

impl FreeSpace {
    pub(super) fn new(views: &[TrainView]) -> Self {
        let train = views.iter().filter(|view| view.split == Split::Train);
        Self {
            views: train.map(free_tiles).collect(),
        }
    }

    /// Judges the cube of edge `side_m` around `centre`.
    pub(super) fn judge(&self, centre: Vec3, side_m: f32) -> Visibility {
        let centre: DVec3 = centre.as_dvec3();
        let mut visibility = Visibility::Unseen;
        // The cube's half diagonal.
        let reach = f64::from(side_m) * 0.87;
        for view in &self.views {
            let p = view.camera_from_local.point(centre);
            let Some(pixel) = view.camera.project(p) else {
                continue;
            };
            let radius = reach / p.z * view.camera.focal_px.max_element();
            let (width, height) = (f64::from(view.camera.width), f64::from(view.camera.height));
            let seen = pixel.x > -radius
                && pixel.y > -radius
                && pixel.x < width + radius
                && pixel.y < height + radius;
            if !seen {
                continue;
            }
            let (free_m, farthest_m) = view.ranges(pixel.x, pixel.y, radius);
            let inside = pixel.x >= radius
                && pixel.y >= radius
                && pixel.x + radius < width
                && pixel.y + radius < height;
            if inside && free_m > p.length() + reach {
                return Visibility::Free;
            }
            if p.length() - reach < farthest_m + HIDDEN_MARGIN_M {
                visibility = Visibility::Possible;
            }
        }
        visibility
    }
}

impl FreeTiles {
    /// The least free range and the farthest return of the tiles within `radius` pixels.
    fn ranges(&self, x: f64, y: f64, radius: f64) -> (f64, f64) {
        // A negative position saturates to the first tile.
        let tile = |v: f64| (v / f64::from(TILE)) as u32;
        let rows = self.free_m.len() as u32 / self.columns;
        let (mut free, mut farthest) = (f32::INFINITY, 0.0f32);
        for row in tile(y - radius)..=tile(y + radius).min(rows - 1) {
            for column in tile(x - radius)..=tile(x + radius).min(self.columns - 1) {
                let at = (row * self.columns + column) as usize;
                free = free.min(self.free_m[at]);
                farthest = farthest.max(self.farthest_m[at]);
                if free == 0.0 && farthest.is_infinite() {
                    return (0.0, f64::INFINITY);
                }
            }
        }
        (f64::from(free), f64::from(farthest))
    }
}

fn free_tiles(view: &TrainView) -> FreeTiles {
    let columns = view.camera.width.div_ceil(TILE);
    let rows = view.camera.height.div_ceil(TILE);
    // Infinite means no return yet, or all sky.
    let mut free_m = vec![f32::INFINITY; (columns * rows) as usize];
    let mut farthest_m = vec![0.0f32; free_m.len()];
    let mut solid = vec![false; free_m.len()];
    for (number, label) in view.labels.iter().enumerate() {
        let (x, y) = (
            number as u32 % view.camera.width,
            number as u32 / view.camera.width,
        );
        solid[(y / TILE * columns + x / TILE) as usize] |= *label != PixelLabel::Sky;
    }
    for depth in &view.depth {
        let [x, y] = depth.pixel.map(|c| c as u32 / TILE);
        if x < columns && y < rows {
            let Some(slack) = depth.source.slack() else {
                continue;
            };
            let tile = (y * columns + x) as usize;
            farthest_m[tile] = farthest_m[tile].max(depth.range_m * (1.0 + slack));
            free_m[tile] = free_m[tile].min(depth.range_m * (1.0 - slack));
        }
    }
    for tile in 0..free_m.len() {
        if farthest_m[tile] == 0.0 {
            farthest_m[tile] = f32::INFINITY;
            if solid[tile] {
                free_m[tile] = 0.0;
            }
        }
    }
    FreeTiles {
        camera: view.camera,
        camera_from_local: view.local_from_camera.inverse(),
        columns,
        free_m,
        farthest_m,
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec2;

    use super::*;
    use crate::camera::Distortion;
    use crate::view::{DepthReturn, DepthSource};

    const WALL_M: f32 = 20.0;

    /// A wall 20 m ahead, with a depth from this source on every pixel; none if `source` is `None`.
    fn free_space(source: Option<DepthSource>) -> FreeSpace {
        let camera = Camera {
            width: 64,
            height: 64,
            focal_px: DVec2::splat(64.0),
            principal_px: DVec2::splat(32.0),
            distortion: Distortion::None,
        };
        let pixels = 0..camera.pixel_count();
        let depth = pixels.filter_map(|at| {
            let pixel = camera.pixel_centre(at);
            let direction = camera.direction(pixel);
            let range_m = WALL_M / direction.z as f32;
            let measured = DepthReturn::lidar(pixel.as_vec2().to_array(), range_m);
            source.map(|source| DepthReturn { source, ..measured })
        });
        FreeSpace::new(&[TrainView {
            frame_index: 0,
            camera,
            local_from_camera: Rigid::IDENTITY,
            rgb: vec![0; 3 * camera.pixel_count()],
            labels: vec![PixelLabel::Foreground; camera.pixel_count()],
            depth: depth.collect(),
            split: Split::Train,
        }])
    }

    #[test]
    fn maps_prove_less_than_lidar_and_points_nothing() {
        use Visibility::{Free, Possible, Unseen};
        // Ahead of the wall by more than a map may be wrong, by less, at the wall, and behind it by less and by more.
        let at = [10.0, 18.0, 20.0, 23.8, 30.0].map(|z| Vec3::new(0.0, 0.0, z));
        for (source, judged) in [
            (
                Some(DepthSource::Lidar),
                [Free, Free, Possible, Unseen, Unseen],
            ),
            (
                Some(DepthSource::Map),
                [Free, Possible, Possible, Possible, Unseen],
            ),
            (Some(DepthSource::SfmPoint), [Possible; 5]),
            (None, [Possible; 5]),
        ] {
            let space = free_space(source);
            assert_eq!(at.map(|p| space.judge(p, 0.8)), judged, "{source:?}");
        }
    }
}
