//! Which rays and pairs a batch of tiles needs: plain arithmetic on the host.

use std::ops::Range;

use backlot_shaders::scene_layout::{RayPairs, RayRequest};
use glam::DVec2;

use crate::scene::{PixelBox, touches};

/// A rectangle of pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Tile {
    pub(super) x: u32,
    pub(super) y: u32,
    pub(super) width: u32,
    pub(super) height: u32,
}

/// An object as far as the choice of rays goes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Outline {
    /// Pixels that may see the object.
    pub(super) pixels: PixelBox,
    /// Rays per pixel side where the object is met.
    pub(super) supersample: u32,
}

/// The pixels of a batch, tile after tile, and the objects that may be seen in each.
#[derive(Clone, Debug, Default)]
pub(super) struct Pixels {
    /// Column and row.
    pub(super) at: Vec<[u32; 2]>,
    active: Vec<u32>,
    ends: Vec<usize>,
}

impl Pixels {
    pub(super) fn of(tiles: &[Tile], objects: &[Outline]) -> Self {
        let mut pixels = Self::default();
        for tile in tiles {
            for i in 0..tile.width * tile.height {
                let at = [tile.x + i % tile.width, tile.y + i / tile.width];
                let centre = DVec2::new(f64::from(at[0]) + 0.5, f64::from(at[1]) + 0.5);
                let seen = (0..)
                    .zip(objects)
                    .filter(|(_, o)| touches(&o.pixels, centre));
                pixels.active.extend(seen.map(|(i, _)| i));
                pixels.at.push(at);
                pixels.ends.push(pixels.active.len());
            }
        }
        pixels
    }

    pub(super) fn len(&self) -> usize {
        self.at.len()
    }

    /// Objects that a pixel may see, nearest first.
    pub(super) fn active(&self, pixel: usize) -> &[u32] {
        let start = pixel.checked_sub(1).map_or(0, |before| self.ends[before]);
        &self.active[start..self.ends[pixel]]
    }

    /// Rays per side at which a pixel must be probed for small objects: the most that any of them asks for, if more than `least`.
    pub(super) fn probe_side(&self, pixel: usize, objects: &[Outline], least: u32) -> Option<u32> {
        let wanted = self.active(pixel).iter();
        wanted
            .map(|o| objects[*o as usize].supersample)
            .max()
            .filter(|side| *side > least)
    }
}

/// The rays of a batch's pixels, and the pairs of rays and objects.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Plan {
    pub(super) requests: Vec<RayRequest>,
    /// First ray of each pixel, and one past the last.
    pub(super) first_rays: Vec<u32>,
    /// Rays of the pairs: those of one object after those of another.
    pub(super) pair_requests: Vec<RayRequest>,
    /// Pairs of each object.
    pub(super) object_pairs: Vec<Range<u32>>,
    /// Each ray's range of `pair_order`.
    pub(super) ray_pairs: Vec<RayPairs>,
    pub(super) pair_order: Vec<u32>,
}

impl Plan {
    /// Rays for the pixels whose side is not 0, and their pairs with the active objects that `takes(pixel, object)`.
    pub(super) fn new(
        pixels: &Pixels,
        object_count: usize,
        side: impl Fn(usize) -> u32,
        takes: impl Fn(usize, u32) -> bool,
    ) -> Self {
        let mut plan = Self::default();
        let mut by_object: Vec<Vec<RayRequest>> = vec![Vec::new(); object_count];
        let mut of_rays: Vec<(u32, u32)> = Vec::new();
        for (pixel, [x, y]) in pixels.at.iter().enumerate() {
            plan.first_rays.push(plan.requests.len() as u32);
            let side = side(pixel);
            for sub in 0..side * side {
                let request = RayRequest {
                    x: *x,
                    y: *y,
                    sub,
                    side,
                };
                let start = of_rays.len() as u32;
                for object in pixels.active(pixel) {
                    if takes(pixel, *object) {
                        let own = &mut by_object[*object as usize];
                        of_rays.push((*object, own.len() as u32));
                        own.push(request);
                    }
                }
                plan.requests.push(request);
                plan.ray_pairs.push(RayPairs {
                    start,
                    count: of_rays.len() as u32 - start,
                });
            }
        }
        plan.first_rays.push(plan.requests.len() as u32);
        for own in by_object {
            let start = plan.pair_requests.len() as u32;
            plan.pair_requests.extend(own);
            plan.object_pairs
                .push(start..plan.pair_requests.len() as u32);
        }
        let number = |(object, own): (u32, u32)| plan.object_pairs[object as usize].start + own;
        plan.pair_order = of_rays.into_iter().map(number).collect();
        plan
    }

    /// Rays of a pixel.
    pub(super) fn rays(&self, pixel: usize) -> Range<usize> {
        self.first_rays[pixel] as usize..self.first_rays[pixel + 1] as usize
    }

    /// Pairs of a ray, in the order of the pixel's active objects.
    pub(super) fn pairs(&self, ray: usize) -> &[u32] {
        let RayPairs { start, count } = self.ray_pairs[ray];
        &self.pair_order[start as usize..(start + count) as usize]
    }
}

/// The image cut into tiles of `side` pixels, row by row.
pub(super) fn tiles(width: u32, height: u32, side: u32) -> Vec<Tile> {
    let mut tiles = Vec::new();
    for y in (0..height).step_by(side as usize) {
        for x in (0..width).step_by(side as usize) {
            tiles.push(Tile {
                x,
                y,
                width: side.min(width - x),
                height: side.min(height - y),
            });
        }
    }
    tiles
}

/// The tiles in an order in which any few in a row lie all over the image: batches then cost alike, wherever sky and cars are, and the last
/// one tells what the next will take.
pub(super) fn spread(tiles: &[Tile]) -> Vec<Tile> {
    let count = tiles.len();
    // Multiples of the golden ratio spread best; a stride without a common divisor meets every tile once.
    let golden = (count as f64 * 0.618_034) as usize;
    let stride = (golden.max(1)..).find(|stride| divisor(*stride, count) == 1);
    let stride = stride.unwrap_or(1);
    (0..count).map(|i| tiles[i * stride % count]).collect()
}

/// The greatest common divisor.
fn divisor(a: usize, b: usize) -> usize {
    if b == 0 { a } else { divisor(b, a % b) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn outline(x: f64, y: f64, width: f64, supersample: u32) -> Outline {
        let min = DVec2::new(x, y);
        Outline {
            pixels: PixelBox {
                min,
                max: min + width,
            },
            supersample,
        }
    }

    #[test]
    fn tiles_cover_every_pixel_once() {
        let mut seen = vec![0; 37 * 21];
        for tile in tiles(37, 21, 16) {
            for y in tile.y..tile.y + tile.height {
                for x in tile.x..tile.x + tile.width {
                    seen[(y * 37 + x) as usize] += 1;
                }
            }
        }
        assert!(seen.iter().all(|count| *count == 1));
    }

    #[test]
    fn spread_tiles_are_the_same_tiles_and_few_of_them_lie_everywhere() {
        for (width, height) in [(1, 1), (4, 4), (37, 21), (310, 94), (1242, 375)] {
            let rows = tiles(width, height, 4);
            let mut all = spread(&rows);
            let sixteenth = &all[..all.len().div_ceil(16)];
            if all.len() > 1000 {
                for quarter in 0..4 {
                    let own = |tile: &&Tile| 4 * tile.y / height == quarter;
                    let share = sixteenth.iter().filter(own).count() * 4;
                    assert!(share * 5 > sixteenth.len() * 4, "{width} x {height}");
                }
            }
            all.sort_by_key(|tile| (tile.y, tile.x));
            assert_eq!(all, rows);
        }
        assert!(spread(&[]).is_empty());
    }

    #[test]
    fn every_ray_has_the_pairs_of_its_pixel() {
        let objects = [outline(2.0, 2.0, 3.0, 2), outline(4.0, 0.0, 6.0, 1)];
        let pixels = Pixels::of(&tiles(12, 8, 8), &objects);
        let side = |pixel: usize| pixels.probe_side(pixel, &objects, 1).unwrap_or(1);
        let plan = Plan::new(&pixels, objects.len(), side, |_, _| true);
        assert_eq!(pixels.len(), 96);
        let mut pairs_seen = vec![0; plan.pair_requests.len()];
        for pixel in 0..pixels.len() {
            let rays = plan.rays(pixel);
            assert_eq!(rays.len() as u32, side(pixel).pow(2));
            for ray in rays {
                let request = plan.requests[ray];
                assert_eq!([request.x, request.y], pixels.at[pixel]);
                assert_eq!(plan.pairs(ray).len(), pixels.active(pixel).len());
                for (pair, object) in plan.pairs(ray).iter().zip(pixels.active(pixel)) {
                    assert!(plan.object_pairs[*object as usize].contains(pair));
                    assert_eq!(plan.pair_requests[*pair as usize], request);
                    pairs_seen[*pair as usize] += 1;
                }
            }
        }
        assert!(pairs_seen.iter().all(|count| *count == 1) && pairs_seen.len() > 50);
        let both = (0..pixels.len()).filter(|p| pixels.active(*p).len() == 2);
        assert!(both.count() > 0);
    }

    #[test]
    fn pixels_and_objects_can_be_left_out() {
        let objects = [outline(0.0, 0.0, 9.0, 2), outline(0.0, 0.0, 9.0, 1)];
        let pixels = Pixels::of(&tiles(4, 4, 4), &objects);
        let plan = Plan::new(&pixels, 2, |p| u32::from(p == 5), |_, object| object == 1);
        assert_eq!(plan.requests.len(), 1);
        assert_eq!(plan.object_pairs, [0..0, 0..1]);
        assert_eq!(plan.pairs(0), [0]);
        assert_eq!(plan.rays(5), 0..1);
        assert!(plan.rays(6).is_empty());
    }
}
