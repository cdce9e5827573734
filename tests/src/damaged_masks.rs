//! A log's instance masks as a segmenter would give them: without tracks, some missed, some false, some merged.

use std::collections::BTreeMap;
use std::io::Cursor;

use backlot_client::read_log::ReadLog;
use backlot_proto::v1;
use image::{ImageBuffer, ImageFormat, Luma};

/// Values row-major.
pub type Mask = ImageBuffer<Luma<u16>, Vec<u16>>;

/// Objects of which less is seen are found by no segmenter.
const LEAST_SEEN_PX: usize = 40;
/// One object in this many is missed, one is merged with another, and there is one false mask for as many.
const ONE_IN: u64 = 10;

/// What a free mask really is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Truth {
    /// The whole visible part of the track of this index.
    Intact(usize),
    Merged,
    False,
}

/// Truths of a log's free masks: for each frame, by the mask's value.
pub type Truths = Vec<BTreeMap<u16, Truth>>;

/// Replaces every instance mask of the log by a free one, damaged as `seed` says.
///
/// # Panics
/// If the log's masks are not those of the generator.
pub fn damage(log: &mut ReadLog, seed: u64) -> Truths {
    let mut random = Random(seed);
    let mut truths = Vec::new();
    for index in 0..log.drive_log.frames.len() {
        let known = log.drive_log.frames[index].instance_mask.take();
        let exact = read_mask(log, &known.expect("generated frames have masks"));
        let (free, truth) = damaged(&exact, &mut random);
        let mut bytes = Cursor::new(Vec::new());
        free.write_to(&mut bytes, ImageFormat::Png)
            .expect("a mask encodes");
        let blob = log.add_bytes(bytes.into_inner());
        log.drive_log.frames[index].free_instance_mask = Some(blob);
        truths.push(truth);
    }
    truths
}

/// An instance mask of a generated log.
///
/// # Panics
/// If it is not there or no PNG.
pub fn read_mask(log: &ReadLog, blob: &v1::BlobRef) -> Mask {
    let bytes = log.blobs[&blob.digest].read().expect("the mask is there");
    image::load_from_memory(&bytes)
        .expect("it is a PNG")
        .into_luma16()
}

/// 64 bits of splitmix64 at a time: the same numbers everywhere.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    fn below(&mut self, end: u64) -> u64 {
        self.next() % end
    }

    fn happens(&mut self) -> bool {
        self.below(ONE_IN) == 0
    }
}

/// An instance of the exact mask.
struct Seen {
    value: u16,
    pixels: Vec<(u32, u32)>,
}

fn damaged(exact: &Mask, random: &mut Random) -> (Mask, BTreeMap<u16, Truth>) {
    let seen = seen(exact);
    let mut group: BTreeMap<u16, usize> = BTreeMap::new();
    let mut truth_of = Vec::new();
    for object in &seen {
        if random.happens() {
            continue;
        }
        group.insert(object.value, truth_of.len());
        truth_of.push(Truth::Intact(usize::from(object.value) - 1));
    }
    for object in &seen {
        if random.happens()
            && let Some(other) = nearest(object, &seen, &group)
            && let Some(&own) = group.get(&object.value)
        {
            let joined = group[&other];
            group.values_mut().filter(|g| **g == own).for_each(|g| {
                *g = joined;
            });
            truth_of[joined] = Truth::Merged;
        }
    }
    // Values that tell nothing about tracks, in no order.
    let first = 1 + random.below(40_000) as u16;
    let stride = 1 + random.below(40) as u16;
    let value = |group: usize| first + stride * group as u16;
    let mut free = Mask::from_fn(exact.width(), exact.height(), |x, y| {
        let found = group.get(&exact.get_pixel(x, y).0[0]);
        Luma([found.map_or(0, |g| value(*g))])
    });
    let mut truths: BTreeMap<u16, Truth> =
        group.values().map(|&g| (value(g), truth_of[g])).collect();
    for extra in 0..seen.len() {
        if random.happens() {
            let value = value(truth_of.len() + extra);
            if add_false(&mut free, exact, value, random) {
                truths.insert(value, Truth::False);
            }
        }
    }
    (free, truths)
}

fn seen(exact: &Mask) -> Vec<Seen> {
    let mut pixels: BTreeMap<u16, Vec<(u32, u32)>> = BTreeMap::new();
    for (x, y, value) in exact.enumerate_pixels() {
        pixels.entry(value.0[0]).or_default().push((x, y));
    }
    let objects = pixels
        .into_iter()
        .filter(|(value, pixels)| *value != 0 && pixels.len() >= LEAST_SEEN_PX);
    objects
        .map(|(value, pixels)| Seen { value, pixels })
        .collect()
}

/// The object that is found too and whose pixels come nearest: segmenters merge neighbours.
fn nearest(object: &Seen, seen: &[Seen], found: &BTreeMap<u16, usize>) -> Option<u16> {
    let distance = |other: &Seen| {
        let sparse = |o: &'_ Seen| o.pixels.iter().step_by(5).copied().collect::<Vec<_>>();
        let (a, b) = (sparse(object), sparse(other));
        let square = |(ax, ay): (u32, u32), (bx, by): (u32, u32)| {
            u64::from(ax.abs_diff(bx)).pow(2) + u64::from(ay.abs_diff(by)).pow(2)
        };
        a.iter()
            .flat_map(|&a| b.iter().map(move |&b| square(a, b)))
            .min()
    };
    seen.iter()
        .filter(|other| other.value != object.value && found.contains_key(&other.value))
        .min_by_key(|other| distance(other))
        .map(|other| other.value)
}

/// Draws an ellipse where nothing is; false if all of it falls on objects.
fn add_false(free: &mut Mask, exact: &Mask, value: u16, random: &mut Random) -> bool {
    let (width, height) = exact.dimensions();
    let centre = (
        random.below(u64::from(width)) as f64,
        random.below(u64::from(height)) as f64,
    );
    let radii = (6.0 + random.below(40) as f64, 5.0 + random.below(20) as f64);
    let mut drawn = false;
    for (x, y, pixel) in free.enumerate_pixels_mut() {
        let from_centre = (
            (f64::from(x) - centre.0) / radii.0,
            (f64::from(y) - centre.1) / radii.1,
        );
        let inside = from_centre.0.powi(2) + from_centre.1.powi(2) < 1.0;
        if inside && pixel.0[0] == 0 && exact.get_pixel(x, y).0[0] == 0 {
            pixel.0[0] = value;
            drawn = true;
        }
    }
    drawn
}
