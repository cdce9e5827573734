//! Finds the sun in the shadows that a background's ground shows.
//!
//! Buildings, trees and parked cars throw shadows whose places follow from the background's own density and a direction of the sun. The
//! direction is right whose shadows lie where the ground is darker than around. Only places within a few metres are compared, so that a
//! dark road beside a bright pavement says little. How much darker the ground is in the shade is the sun's part of the light.

use glam::{DVec2, DVec3};
use rayon::prelude::*;

use super::daylight::{Daylight, SunSource};
use super::ground_light::{Piece, look, median};
use super::recording::Recording;
use super::sun_grid::{SUN_LIFT_M, SUN_RANGE_M, transmittance};
use super::valid_region::ValidRegion;
use crate::field::{Field, RaySample};

/// Pieces of ground that are compared, at most; more say the same again.
const MAX_PIECES: usize = 2500;
/// Distances over which places are compared: roofs are known to a metre or two, and a shadow's edge is no better.
const COMPARED_M: [f64; 3] = [2.0, 4.0, 8.0];
/// Fewer comparisons, or a weaker correlation, are not shadows.
const LEAST_PAIRS: usize = 200;
const LEAST_CORRELATION: f64 = 0.25;
/// Another sun further than this from the best that explains the ground nearly as well makes both a guess.
const SAME_SUN_DEG: f64 = 35.0;
const RIVAL: f64 = 0.85;
/// Paint and patches differ as much as a shadow's edge; more is an outlier.
const MAX_STEP: f64 = 1.5;
/// Ground in the shade has at most this part of the light of ground in the sun, and each of both is this part of all ground.
const MAX_SHADE: f64 = 0.67;
const LEAST_CLASS: f64 = 0.05;
/// Ground that is bright must lie in the sun more than the dark by this part, for the geometry to agree.
const LEAST_AGREEMENT: f64 = 0.25;
/// Shares outside would be measured on something else than shadows.
const SHARE: (f64, f64) = (0.3, 0.9);
/// The search over azimuth and elevation, then refined by halves of its step.
const STEP_DEG: f64 = 10.0;
const ELEVATIONS_DEG: (f64, f64) = (15.0, 75.0);
const REFINEMENTS: u32 = 2;

/// The sunlight over a background: from the log's direction of the sun, else from the shadows on its ground. `None` where there is
/// no direction and no shadow tells one.
pub fn measure_daylight(
    field: &Field,
    recording: &Recording,
    region: &ValidRegion,
) -> Option<Daylight> {
    let ground = Ground::look(field, recording, region);
    if let Some(sun) = recording.sun_direction_local {
        let mut day = Daylight::clear_sky(sun, SunSource::Log)?;
        let parts = ground.parts(field, day.sun_direction_local);
        ground.measure(&parts, &mut day);
        return Some(day);
    }
    let direction = ground.search(field)?;
    let mut day = Daylight::clear_sky(direction, SunSource::Estimated)?;
    let parts = ground.parts(field, day.sun_direction_local);
    ground.measure(&parts, &mut day).then_some(day)
}

/// Azimuth from x towards y, and elevation, in degrees.
type Angles = (f64, f64);

/// Pieces of ground as the cameras see them in the field.
struct Ground {
    pieces: Vec<Piece>,
    /// Neighbours, as indices of pieces.
    pairs: Vec<(usize, usize)>,
}

impl Ground {
    fn look(field: &Field, recording: &Recording, region: &ValidRegion) -> Self {
        let cells = chosen_cells(region);
        let seen = look(field, recording, region, &cells);
        let (cells, pieces): (Vec<usize>, Vec<Piece>) = cells
            .into_iter()
            .zip(seen)
            .filter_map(|(cell, piece)| Some((cell, piece?)))
            .unzip();
        Self {
            pairs: neighbours(&cells, region),
            pieces,
        }
    }

    /// The direction that explains the ground best, if one does.
    fn search(&self, field: &Field) -> Option<DVec3> {
        if self.pairs.len() < LEAST_PAIRS {
            return None;
        }
        let mut step = STEP_DEG;
        let (low, high) = ELEVATIONS_DEG;
        let rows = ((high - low) / step) as i32;
        let columns = (360.0 / step) as i32;
        let coarse = (0..=rows).flat_map(|row| {
            (0..columns).map(move |c| (f64::from(c) * STEP_DEG, low + f64::from(row) * STEP_DEG))
        });
        let scored = self.scores(field, coarse.collect());
        let mut best = best_of(&scored)?;
        let found = direction(best.1);
        let rivals = scored.iter().filter(|(score, angle)| {
            let apart = direction(*angle).angle_between(found).to_degrees();
            apart > SAME_SUN_DEG && *score > RIVAL * best.0
        });
        if best.0 < LEAST_CORRELATION || rivals.count() > 0 {
            return None;
        }
        for _ in 0..REFINEMENTS {
            step *= 0.5;
            let (azimuth, elevation) = best.1;
            let offsets = (-1..=1).flat_map(|i| (-1..=1).map(move |j| (i, j)));
            let around = offsets.map(|(i, j)| {
                (
                    azimuth + f64::from(i) * step,
                    elevation + f64::from(j) * step,
                )
            });
            best = best_of(&self.scores(field, around.collect()))?;
        }
        Some(direction(best.1))
    }

    /// Correlations of the shadows of each direction with the ground.
    fn scores(&self, field: &Field, angles: Vec<Angles>) -> Vec<(f64, Angles)> {
        let scored = angles.into_iter().map(|angles| {
            let parts = self.parts(field, direction(angles));
            (self.correlation(&parts), angles)
        });
        scored.collect()
    }

    /// The part of the sun that reaches each piece past the background.
    fn parts(&self, field: &Field, sun: DVec3) -> Vec<f64> {
        self.pieces
            .par_iter()
            .with_min_len(64)
            .map_init(Vec::new, |samples: &mut Vec<RaySample>, piece| {
                let from = piece.place + sun * (SUN_LIFT_M / sun.z);
                transmittance(field, from, sun, SUN_RANGE_M, samples)
            })
            .collect()
    }

    /// Of the differences between neighbours in sun and in brightness.
    fn correlation(&self, parts: &[f64]) -> f64 {
        let (mut both, mut sun_only, mut light_only) = (0.0, 0.0, 0.0);
        for &(a, b) in &self.pairs {
            let sun = parts[a] - parts[b];
            let light = self.pieces[a].ln_light() - self.pieces[b].ln_light();
            let light = light.clamp(-MAX_STEP, MAX_STEP);
            both += sun * light;
            sun_only += sun * sun;
            light_only += light * light;
        }
        both / (sun_only * light_only).sqrt().max(1e-9)
    }

    /// Measures the light of shade and sun on the two kinds of ground there are, if these are what the geometry says.
    fn measure(&self, parts: &[f64], day: &mut Daylight) -> bool {
        let Some(limit) = self.split() else {
            return false;
        };
        let is_bright = |i: &usize| self.pieces[*i].ln_light() > limit;
        let (bright, dark): (Vec<usize>, Vec<usize>) = (0..self.pieces.len()).partition(is_bright);
        let least = (LEAST_CLASS * self.pieces.len() as f64) as usize;
        if bright.len().min(dark.len()) <= least {
            return false;
        }
        let mean = |of: &[usize]| of.iter().map(|i| parts[*i]).sum::<f64>() / of.len() as f64;
        let middle = |of: &[usize], value: &dyn Fn(&Piece) -> f64| {
            let mut values: Vec<f64> = of.iter().map(|i| value(&self.pieces[*i])).collect();
            median(&mut values)
        };
        let tones = [&dark, &bright].map(|of| middle(of, &Piece::ln_light));
        let contrast = (tones[0] - tones[1]).exp();
        if mean(&bright) - mean(&dark) < LEAST_AGREEMENT || contrast > MAX_SHADE {
            return false;
        }
        day.ground_ln_light = Some(tones);
        day.sun_share = std::array::from_fn(|c| {
            let [shade, sun] = [&dark, &bright].map(|of| middle(of, &|p: &Piece| p.ln_rgb[c]));
            (1.0 - (shade - sun).exp()).clamp(SHARE.0, SHARE.1)
        });
        true
    }

    /// The brightness that parts the ground into two kinds with the least spread within each (Otsu).
    fn split(&self) -> Option<f64> {
        let mut light: Vec<f64> = self.pieces.iter().map(Piece::ln_light).collect();
        light.sort_by(f64::total_cmp);
        let (count, total) = (light.len() as f64, light.iter().sum::<f64>());
        let (mut below, mut best) = (0.0, None::<(f64, f64)>);
        for (i, value) in light.iter().enumerate().take(light.len().saturating_sub(1)) {
            below += value;
            let n = (i + 1) as f64;
            let apart = below / n - (total - below) / (count - n);
            let between = n * (count - n) * apart * apart;
            if best.is_none_or(|(most, _)| between > most) {
                best = Some((between, 0.5 * (value + light[i + 1])));
            }
        }
        best.map(|(_, limit)| limit)
    }
}

/// Cells with ground; whole blocks of neighbours are left out where there are too many.
fn chosen_cells(region: &ValidRegion) -> Vec<usize> {
    /// Side of a block: as wide as the widest comparison.
    const BLOCK_M: f64 = 8.0;
    let known = (0..region.cells.len()).filter(|cell| region.ground_m[*cell].is_finite());
    let cells: Vec<usize> = known.collect();
    // Half of the cells or so are seen.
    let every = cells.len().div_ceil(2 * MAX_PIECES).max(1) as i64;
    let block = |cell: &usize| {
        let at = ((region.centre(*cell) - region.origin) / BLOCK_M).floor();
        (at.x as i64).rem_euclid(every)
    };
    cells.into_iter().filter(|cell| block(cell) == 0).collect()
}

fn neighbours(cells: &[usize], region: &ValidRegion) -> Vec<(usize, usize)> {
    let mut number = vec![usize::MAX; region.cells.len()];
    for (i, cell) in cells.iter().enumerate() {
        number[*cell] = i;
    }
    let mut pairs = Vec::new();
    for (i, cell) in cells.iter().enumerate() {
        for reach in COMPARED_M {
            for (x, y) in [(1.0, 0.0), (0.0, 1.0), (0.7, 0.7), (0.7, -0.7)] {
                let there = region.centre(*cell) + DVec2::new(x, y) * reach;
                let other = region.index_at(there).map(|c| number[c]);
                pairs.extend(other.filter(|j| *j != usize::MAX).map(|j| (i, j)));
            }
        }
    }
    pairs
}

fn best_of(scored: &[(f64, Angles)]) -> Option<(f64, Angles)> {
    let scored = scored.iter().copied();
    scored.max_by(|(a, _), (b, _)| a.total_cmp(b))
}

fn direction((azimuth, elevation): Angles) -> DVec3 {
    let (sin_a, cos_a) = libm::sincos(azimuth.to_radians());
    let (sin_e, cos_e) = libm::sincos(elevation.to_radians());
    DVec3::new(cos_e * cos_a, cos_e * sin_a, sin_e)
}
