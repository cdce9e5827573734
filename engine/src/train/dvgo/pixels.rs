//! Draws the rays of a step. Rays are made from the 8-bit images when they are needed, never stored.

use glam::DVec2;
use rayon::prelude::*;

use super::march::Medium;
use crate::field::Ray;
use crate::scene::Draws;
use crate::view::{PixelLabel, Split, TrainView};

/// A training ray.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct PixelRay {
    pub(crate) ray: Ray,
    /// Where sampling may begin, in metres along the ray.
    pub(crate) near_m: f32,
    /// sRGB.
    pub(crate) color: [f32; 3],
}

/// The training images.
#[derive(Clone, Debug)]
pub(super) struct Pixels<'a> {
    views: Vec<&'a TrainView>,
    /// Number of the first pixel of every view, and of all pixels at the end.
    starts: Vec<u64>,
    /// Distance along the optical axis from which on space is looked at, in metres.
    near_m: f64,
}

/// Which pixels a stage trains on.
#[derive(Clone, Debug)]
pub(super) enum Choice {
    /// Every ray a pixel of its own, from all.
    Random,
    /// These pixels in a shuffled order, again and again in another.
    Shuffled(Vec<u32>),
}

impl<'a> Pixels<'a> {
    pub(super) fn new(views: &'a [TrainView], near_m: f64) -> Self {
        let train = views.iter().filter(|view| view.split == Split::Train);
        let views: Vec<&TrainView> = train.collect();
        let mut starts = vec![0];
        for view in &views {
            starts.push(starts[starts.len() - 1] + view.camera.pixel_count() as u64);
        }
        Self {
            views,
            starts,
            near_m,
        }
    }

    pub(super) fn near_m(&self) -> f64 {
        self.near_m
    }

    pub(super) fn views(&self) -> &[&'a TrainView] {
        &self.views
    }

    /// The pixels whose rays meet the medium's mask and that supervise something.
    pub(super) fn in_mask(&self, medium: &Medium<'_>) -> Vec<u32> {
        let count = self.starts[self.starts.len() - 1];
        assert!(
            count <= u64::from(u32::MAX),
            "pixels are numbered in 32 bits"
        );
        (0..count as u32)
            .into_par_iter()
            .with_min_len(4_096)
            .filter(|number| {
                let (view, x, y) = self.locate(u64::from(*number));
                let known =
                    view.labels[(y * view.camera.width + x) as usize] != PixelLabel::Unknown;
                let ray = self.ray(view, x, y);
                known && medium.hits_mask(ray.ray, ray.near_m)
            })
            .collect()
    }

    /// Replaces `out` by the `count` rays of step number `step`.
    pub(super) fn draw(
        &self,
        choice: &Choice,
        (seed, step): (u64, u64),
        count: usize,
        out: &mut Vec<PixelRay>,
    ) {
        let order = match choice {
            Choice::Random => None,
            Choice::Shuffled(pixels) => Some((pixels, Batch::of(pixels.len(), count, step, seed))),
        };
        (0..count)
            .into_par_iter()
            .with_min_len(256)
            .map(|number| match &order {
                None => {
                    let mut draws = Draws::new(seed, step, number as u32);
                    let view = self.views[draws.below(self.views.len())];
                    let x = draws.below(view.camera.width as usize) as u32;
                    let y = draws.below(view.camera.height as usize) as u32;
                    self.ray(view, x, y)
                }
                Some((pixels, batch)) => {
                    let pixel = pixels[batch.at(number as u64) as usize];
                    let (view, x, y) = self.locate(u64::from(pixel));
                    self.ray(view, x, y)
                }
            })
            .collect_into_vec(out);
    }

    fn locate(&self, pixel: u64) -> (&'a TrainView, u32, u32) {
        let number = self.starts.partition_point(|start| *start <= pixel) - 1;
        let view = self.views[number];
        let local = (pixel - self.starts[number]) as u32;
        (view, local % view.camera.width, local / view.camera.width)
    }

    pub(super) fn ray(&self, view: &TrainView, x: u32, y: u32) -> PixelRay {
        let pixel = DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5);
        let direction = view.camera.direction(pixel);
        let at = 3 * (y as usize * view.camera.width as usize + x as usize);
        PixelRay {
            ray: Ray {
                origin: view.local_from_camera.translation_m.as_vec3(),
                direction: view.local_from_camera.direction(direction).as_vec3(),
            },
            near_m: (self.near_m / direction.z) as f32,
            color: [0, 1, 2].map(|c| f32::from(view.rgb[at + c]) / 255.0),
        }
    }
}

/// Where a step stands in the shuffled order: batches of one pass share no pixel; what is left of a pass is dropped.
#[derive(Clone, Copy, Debug)]
struct Batch {
    shuffle: Shuffle,
    first: u64,
}

impl Batch {
    fn of(pixels: usize, count: usize, step: u64, seed: u64) -> Self {
        let per_pass = (pixels / count).max(1) as u64;
        let pass = step / per_pass;
        Self {
            shuffle: Shuffle::new(pixels as u64, seed, pass),
            first: step % per_pass * count as u64,
        }
    }

    fn at(&self, number: u64) -> u64 {
        // Fewer pixels than rays: some come twice.
        self.shuffle.at((self.first + number) % self.shuffle.count)
    }
}

/// A pseudo-random order of 0..count: a balanced Feistel network over the next power of four, walked until it lands in range
/// (Black and Rogaway, "Ciphers with arbitrary finite domains", 2002). Needs no memory, unlike a shuffled list.
#[derive(Clone, Copy, Debug)]
struct Shuffle {
    count: u64,
    half_bits: u32,
    keys: [u64; ROUNDS],
}

const ROUNDS: usize = 4;

impl Shuffle {
    fn new(count: u64, seed: u64, pass: u64) -> Self {
        let bits = 64 - count.max(2).saturating_sub(1).leading_zeros();
        let mut draws = Draws::new(seed, pass, u32::MAX);
        Self {
            count,
            half_bits: bits.div_ceil(2),
            keys: std::array::from_fn(|_| draws.bits()),
        }
    }

    fn at(&self, number: u64) -> u64 {
        let mut at = number;
        loop {
            at = self.permute(at);
            if at < self.count {
                return at;
            }
        }
    }

    fn permute(&self, x: u64) -> u64 {
        let low = (1 << self.half_bits) - 1;
        let (mut left, mut right) = (x >> self.half_bits, x & low);
        for key in self.keys {
            // One round of a 64-bit mixer (the golden ratio's multiple, high bits kept).
            let mixed = (right ^ key).wrapping_mul(0x9E37_79B9_7F4A_7C15);
            let mixed = (mixed ^ mixed >> 29).wrapping_mul(0xBF58_476D_1CE4_E5B9);
            (left, right) = (right, left ^ (mixed >> 32 & low));
        }
        left << self.half_bits | right
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pass_shows_every_pixel_once_and_passes_differ() {
        for count in [1u64, 2, 5, 1_000, 4_097] {
            let order = |pass| -> Vec<u64> {
                let shuffle = Shuffle::new(count, 7, pass);
                (0..count).map(|number| shuffle.at(number)).collect()
            };
            let mut sorted = order(0);
            sorted.sort_unstable();
            assert_eq!(sorted, (0..count).collect::<Vec<_>>());
            assert!(count < 5 || order(0) != order(1));
        }
    }

    #[test]
    fn batches_of_a_pass_are_disjoint_and_the_rest_is_dropped() {
        let (pixels, count) = (1_000, 300);
        let batch = |step| -> Vec<u64> {
            let batch = Batch::of(pixels, count, step, 3);
            (0..count as u64).map(|number| batch.at(number)).collect()
        };
        let mut seen: Vec<u64> = (0..3).flat_map(batch).collect();
        seen.sort_unstable();
        seen.dedup();
        assert_eq!(seen.len(), 900);
        // The fourth step begins the second pass.
        assert!(batch(3).iter().any(|pixel| seen.contains(pixel)));
        assert_ne!(batch(0), batch(3));
    }
}
