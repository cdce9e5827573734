//! Gives a hole the texture of its surroundings: every patch that touches it is made to look like some patch of the known image.
//!
//! Coarse to fine, patches are matched by PatchMatch (Barnes et al., SIGGRAPH 2009) and vote for the pixels they cover (Wexler,
//! Shechtman and Irani, "Space-time completion of video", PAMI 2007). Sources come from nearly the same height in the image, where the
//! ground is as far away and as coarse as in the hole.

use super::fill::Part;
use super::random::Draws;

/// A cut-out of the image, row-major.
#[derive(Clone, Debug)]
pub(super) struct Canvas {
    pub(super) width: usize,
    pub(super) rgb: Vec<[f32; 3]>,
    pub(super) parts: Vec<Part>,
}

/// Patches are 7 x 7.
const HALF_PATCH: i32 = 3;
/// Sources are at most this far above or below, in pixels of the full size.
const VERTICAL_PX: i32 = 16;
const MAX_LEVELS: usize = 4;
/// Rounds of matching and voting at the coarsest level, and two fewer at each finer one.
const COARSE_ROUNDS: usize = 9;
const LEAST_ROUNDS: usize = 3;
/// Sweeps of propagation and search in a round.
const SWEEPS: usize = 2;
/// A hole's own pixels are guesses: they count less than the known ones around.
const GUESS_WEIGHT: f32 = 0.5;

/// Replaces the colours of the hole, whose present ones are the first guess; all others keep theirs. Returns whether there was
/// anything to copy from.
pub(super) fn texture(canvas: &mut Canvas, draws: &mut Draws) -> bool {
    let mut levels = vec![canvas.clone()];
    while levels.len() < MAX_LEVELS {
        let next = levels[levels.len() - 1].halved();
        if next.sources(VERTICAL_PX >> levels.len()).is_empty() {
            break;
        }
        levels.push(next);
    }
    let mut matched: Option<Matches> = None;
    for (depth, level) in levels.iter_mut().enumerate().rev() {
        let reach = (VERTICAL_PX >> depth).max(1);
        let Some(mut matches) = Matches::new(level, matched.as_ref(), reach, draws) else {
            continue;
        };
        if matched.is_some() {
            matches.vote(level);
        }
        for _ in 0..(LEAST_ROUNDS + 2 * depth).min(COARSE_ROUNDS) {
            for sweep in 0..SWEEPS {
                matches.improve(level, reach, sweep % 2 == 1, draws);
            }
            matches.vote(level);
        }
        matched = Some(matches);
    }
    canvas.rgb.clone_from(&levels[0].rgb);
    matched.is_some()
}

impl Canvas {
    fn height(&self) -> usize {
        self.parts.len() / self.width
    }

    fn at(&self, x: i32, y: i32) -> Option<usize> {
        let inside = (0..self.width as i32).contains(&x) && (0..self.height() as i32).contains(&y);
        inside.then(|| y as usize * self.width + x as usize)
    }

    fn place(&self, i: usize) -> (i32, i32) {
        ((i % self.width) as i32, (i / self.width) as i32)
    }

    /// Half the size: a block with a hole is a hole, one with a barrier and no hole a barrier.
    fn halved(&self) -> Self {
        let (width, height) = (self.width.div_ceil(2), self.height().div_ceil(2));
        let mut half = Self {
            width,
            rgb: vec![[0.0; 3]; width * height],
            parts: vec![Part::Known; width * height],
        };
        for to in 0..width * height {
            let (x, y) = (2 * (to % width) as i32, 2 * (to / width) as i32);
            let (mut sum, mut count) = ([0.0; 3], 0.0);
            for i in [(0, 0), (1, 0), (0, 1), (1, 1)]
                .iter()
                .filter_map(|(dx, dy)| self.at(x + dx, y + dy))
            {
                half.parts[to] = match (half.parts[to], self.parts[i]) {
                    (Part::Hole, _) | (_, Part::Hole) => Part::Hole,
                    (Part::Barrier, _) | (_, Part::Barrier) => Part::Barrier,
                    _ => Part::Known,
                };
                if self.parts[i] != Part::Barrier {
                    count += 1.0;
                    for (sum, value) in sum.iter_mut().zip(self.rgb[i]) {
                        *sum += value;
                    }
                }
            }
            half.rgb[to] = sum.map(|s: f32| s / f32::max(count, 1.0));
        }
        half
    }

    /// Centres of wholly known patches, row by row, among the rows that some hole may copy from.
    fn sources(&self, reach: i32) -> Vec<u32> {
        let rows: Vec<usize> = self.holes().map(|i| i / self.width).collect();
        let (Some(first), Some(last)) = (rows.first(), rows.last()) else {
            return Vec::new();
        };
        let margin = (reach + HALF_PATCH) as usize;
        let from = first.saturating_sub(margin);
        let to = (last + margin + 1).min(self.height());
        (from * self.width..to * self.width)
            .filter(|i| self.is_source(*i))
            .map(|i| i as u32)
            .collect()
    }

    fn is_source(&self, i: usize) -> bool {
        let (x, y) = self.place(i);
        patch().all(|(dx, dy)| {
            self.at(x + dx, y + dy)
                .is_some_and(|i| self.parts[i] == Part::Known)
        })
    }

    fn holes(&self) -> impl Iterator<Item = usize> + '_ {
        (0..self.parts.len()).filter(|i| self.parts[*i] == Part::Hole)
    }
}

fn patch() -> impl Iterator<Item = (i32, i32)> {
    (-HALF_PATCH..=HALF_PATCH).flat_map(|dy| (-HALF_PATCH..=HALF_PATCH).map(move |dx| (dx, dy)))
}

/// For every patch that touches a hole, the source that it looks like.
struct Matches {
    width: usize,
    /// Centres of the patches, ascending.
    centres: Vec<u32>,
    /// Index into `centres`, by pixel; `NONE` elsewhere.
    slot: Vec<u32>,
    is_source: Vec<bool>,
    /// By slot: source and mean squared difference.
    best: Vec<(u32, f32)>,
}

const NONE: u32 = u32::MAX;

impl Matches {
    /// First matches from a coarser level, or random ones; `None` without sources.
    fn new(canvas: &Canvas, coarse: Option<&Self>, reach: i32, draws: &mut Draws) -> Option<Self> {
        let sources = canvas.sources(reach);
        if sources.is_empty() {
            return None;
        }
        let mut is_source = vec![false; canvas.parts.len()];
        for i in &sources {
            is_source[*i as usize] = true;
        }
        let mut slot = vec![NONE; canvas.parts.len()];
        for i in canvas.holes() {
            let (x, y) = canvas.place(i);
            for near in patch().filter_map(|(dx, dy)| canvas.at(x + dx, y + dy)) {
                slot[near] = 0;
            }
        }
        let centres: Vec<u32> = (0..slot.len() as u32)
            .filter(|i| slot[*i as usize] == 0)
            .collect();
        for (index, centre) in centres.iter().enumerate() {
            slot[*centre as usize] = index as u32;
        }
        let mut matches = Self {
            width: canvas.width,
            best: Vec::with_capacity(centres.len()),
            centres,
            slot,
            is_source,
        };
        for slot in 0..matches.centres.len() {
            let centre = matches.centres[slot] as usize;
            let inherited = coarse.and_then(|c| c.doubled(canvas, centre));
            let source = inherited
                .filter(|i| matches.is_source[*i])
                .unwrap_or_else(|| sources[draws.below(sources.len())] as usize);
            let difference = matches.difference(canvas, centre, source, f32::INFINITY);
            matches.best.push((source as u32, difference));
        }
        Some(matches)
    }

    /// The source that the coarser match of a pixel names at this level.
    fn doubled(&self, fine: &Canvas, centre: usize) -> Option<usize> {
        let (x, y) = fine.place(centre);
        let below = (y as usize / 2) * self.width + x as usize / 2;
        let slot = *self.slot.get(below).filter(|s| **s != NONE)?;
        let source = self.best[slot as usize].0 as usize;
        let (sx, sy) = ((source % self.width) as i32, (source / self.width) as i32);
        fine.at(2 * sx + x % 2, 2 * sy + y % 2)
    }

    /// One sweep: neighbours' offsets, then ever nearer random places.
    fn improve(&mut self, canvas: &Canvas, reach: i32, backwards: bool, draws: &mut Draws) {
        let count = self.centres.len();
        for step in 0..count {
            let slot = if backwards { count - 1 - step } else { step };
            let centre = self.centres[slot] as usize;
            let (x, y) = canvas.place(centre);
            let side = if backwards { 1 } else { -1 };
            for (dx, dy) in [(side, 0), (0, side)] {
                let near = canvas.at(x + dx, y + dy).map(|i| self.slot[i]);
                if let Some(near) = near.filter(|s| *s != NONE) {
                    let (sx, sy) = canvas.place(self.best[near as usize].0 as usize);
                    self.consider(canvas, slot, sx - dx, sy - dy, reach);
                }
            }
            let mut radius = canvas.width as i32;
            while radius >= 1 {
                let (sx, sy) = canvas.place(self.best[slot].0 as usize);
                let vertical = radius.min(reach);
                let away = |radius: i32, draws: &mut Draws| {
                    draws.below(2 * radius as usize + 1) as i32 - radius
                };
                let to = (sx + away(radius, draws), sy + away(vertical, draws));
                self.consider(canvas, slot, to.0, to.1, reach);
                radius /= 2;
            }
        }
    }

    fn consider(&mut self, canvas: &Canvas, slot: usize, x: i32, y: i32, reach: i32) {
        let centre = self.centres[slot] as usize;
        let (_, own_y) = canvas.place(centre);
        let Some(source) = canvas.at(x, y).filter(|i| self.is_source[*i]) else {
            return;
        };
        let (present, limit) = self.best[slot];
        let too_far = (canvas.place(present as usize).1 - own_y).abs() > reach;
        if (y - own_y).abs() > reach || source as u32 == present {
            return;
        }
        let limit = if too_far { f32::INFINITY } else { limit };
        let difference = self.difference(canvas, centre, source, limit);
        if difference < limit {
            self.best[slot] = (source as u32, difference);
        }
    }

    /// Weighted mean squared difference of two patches; gives up beyond `limit`.
    fn difference(&self, canvas: &Canvas, centre: usize, source: usize, limit: f32) -> f32 {
        let ((x, y), (sx, sy)) = (canvas.place(centre), canvas.place(source));
        let (mut sum, mut weight) = (0.0, 0.0f32);
        let most = limit * (2 * HALF_PATCH + 1).pow(2) as f32;
        for (dx, dy) in patch() {
            let Some(a) = canvas.at(x + dx, y + dy) else {
                continue;
            };
            let own = match canvas.parts[a] {
                Part::Known => 1.0,
                Part::Hole => GUESS_WEIGHT,
                Part::Smooth | Part::Barrier => continue,
            };
            let b = (sy + dy) as usize * self.width + (sx + dx) as usize;
            let (p, q) = (canvas.rgb[a], canvas.rgb[b]);
            sum += own * (0..3).map(|c| (p[c] - q[c]).powi(2)).sum::<f32>();
            weight += own;
            if sum > most {
                return f32::INFINITY;
            }
        }
        sum / weight.max(1.0)
    }

    /// Sets every pixel of the hole to what the patches over it say, the better ones louder; refreshes the differences.
    fn vote(&mut self, canvas: &mut Canvas) {
        let mut sorted: Vec<f32> = self.best.iter().map(|(_, d)| *d).collect();
        sorted.sort_by(f32::total_cmp);
        let scale = sorted[sorted.len() / 4].max(1e-5);
        let holes: Vec<usize> = canvas.holes().collect();
        for i in holes {
            let (x, y) = canvas.place(i);
            let (mut sum, mut weight) = ([0.0; 3], 0.0);
            for (dx, dy) in patch() {
                let Some(slot) = canvas.at(x + dx, y + dy).map(|c| self.slot[c]) else {
                    continue;
                };
                if slot == NONE {
                    continue;
                }
                let (source, difference) = self.best[slot as usize];
                let (sx, sy) = canvas.place(source as usize);
                let from = (sy - dy) as usize * self.width + (sx - dx) as usize;
                let loud = (-difference / scale).exp() + 1e-9;
                weight += loud;
                for (sum, value) in sum.iter_mut().zip(canvas.rgb[from]) {
                    *sum += loud * value;
                }
            }
            if weight > 0.0 {
                canvas.rgb[i] = sum.map(|s: f32| s / weight);
            }
        }
        for slot in 0..self.centres.len() {
            let (source, _) = self.best[slot];
            let centre = self.centres[slot] as usize;
            let fresh = self.difference(canvas, centre, source as usize, f32::INFINITY);
            self.best[slot].1 = fresh;
        }
    }
}
