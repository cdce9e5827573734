//! The ground as the recording's cameras see it in the background, and which of it lies in the sun.

use std::collections::BTreeMap;

use glam::{DVec2, DVec3, Vec3};
use rayon::prelude::*;

use super::composition::Stage;
use super::daylight::Daylight;
use super::linear::linear_of;
use super::recording::{RecordedFrame, Recording};
use super::valid_region::ValidRegion;
use crate::field::{ColorScratch, Field, RaySample};

/// Ground is looked at from this far: nearer it is under the bonnet, further its pixels are long.
const RANGE_M: (f64, f64) = (4.0, 25.0);
/// The ray must end on the ground: metres, and metres per metre for grazing rays.
const ON_GROUND_M: (f64, f64) = (0.15, 0.04);
const STOP_TAU: f32 = 4.0;
/// Darkest light that is told from black.
const LEAST_LIGHT: f64 = 1e-3;
/// Shadows reach this far from an object, and light is asked for as far.
const AROUND_M: f64 = 8.0;
/// Places this much of the way from shade to sun are taken for the one or the other.
const EDGE: (f64, f64) = (0.25, 0.75);

/// A piece of ground as it is seen.
#[derive(Clone, Copy, Debug)]
pub(super) struct Piece {
    pub(super) place: DVec3,
    /// Natural logarithm of linear light: red, green, blue.
    pub(super) ln_rgb: [f64; 3],
}

impl Piece {
    pub(super) fn ln_light(&self) -> f64 {
        self.ln_rgb.iter().sum::<f64>() / 3.0
    }
}

/// Looks at cells of the region, each from the frame that sees it best; `None` where none sees the ground itself.
pub(super) fn look(
    field: &Field,
    recording: &Recording,
    region: &ValidRegion,
    cells: &[usize],
) -> Vec<Option<Piece>> {
    let seen: Vec<Option<(DVec3, Vec3)>> = cells
        .par_iter()
        .with_min_len(16)
        .map_init(Vec::new, |samples, cell| {
            let height = region.ground_m[*cell];
            let p = height
                .is_finite()
                .then(|| region.centre(*cell).extend(height))?;
            see(field, best_frame(recording, p)?, p, samples)
        })
        .collect();
    let known: Vec<(DVec3, Vec3)> = seen.iter().flatten().copied().collect();
    let positions: Vec<Vec3> = known.iter().map(|(p, _)| p.as_vec3()).collect();
    let directions: Vec<Vec3> = known.iter().map(|(_, d)| *d).collect();
    let (mut colors, mut scratch) = (Vec::new(), ColorScratch::default());
    field.colors(&positions, &directions, &mut colors, &mut scratch);
    let ln = |c: f32| linear_of(f64::from(c)).max(LEAST_LIGHT).ln();
    let mut colors = colors.into_iter();
    seen.into_iter()
        .map(|seen| {
            let (place, _) = seen?;
            let ln_rgb = colors.next()?.map(ln);
            Some(Piece { place, ln_rgb })
        })
        .collect()
}

/// The frame that sees a point from nearest to the middle of the good range.
fn best_frame(recording: &Recording, p: DVec3) -> Option<&RecordedFrame> {
    let wanted = 0.5 * (RANGE_M.0 + RANGE_M.1);
    let seen = recording.frames.iter().filter_map(|frame| {
        let range = (p - frame.local_from_camera.translation_m).length();
        if !(RANGE_M.0..RANGE_M.1).contains(&range) {
            return None;
        }
        let camera = recording.camera(&frame.camera_id)?;
        let pixel = camera.project(frame.local_from_camera.inverse().point(p))?;
        let size = DVec2::new(f64::from(camera.width), f64::from(camera.height));
        let inside = pixel.cmpge(DVec2::ZERO).all() && pixel.cmplt(size).all();
        inside.then_some(((range - wanted).abs(), frame))
    });
    seen.min_by(|(a, _), (b, _)| a.total_cmp(b)).map(|(_, f)| f)
}

/// The point at which a frame's ray meets the ground near `p`, and the ray's direction.
fn see(
    field: &Field,
    frame: &RecordedFrame,
    p: DVec3,
    samples: &mut Vec<RaySample>,
) -> Option<(DVec3, Vec3)> {
    let eye = frame.local_from_camera.translation_m;
    let range = (p - eye).length();
    let direction = (p - eye) / range;
    let slack = ON_GROUND_M.0 + ON_GROUND_M.1 * range;
    samples.clear();
    let (from, along) = (eye.as_vec3(), direction.as_vec3());
    let end = (range + slack) as f32;
    field.march(from, along, 0.0, end, STOP_TAU, samples);
    let mut tau = 0.0;
    let hit = samples.iter().find(|sample| {
        tau += sample.sigma * sample.dt;
        tau >= std::f32::consts::LN_2
    })?;
    let t = f64::from(hit.t);
    ((t - range).abs() < slack).then(|| (eye + direction * t, along))
}

/// Which ground lies in the sun, by its brightness: buildings that no camera saw throw shadows too.
pub(super) struct GroundSun<'a> {
    region: &'a ValidRegion,
    sun: DVec3,
    /// Part of the sun by cell; the others are not known.
    parts: BTreeMap<usize, f64>,
}

impl<'a> GroundSun<'a> {
    /// The ground around the given local points.
    pub(super) fn around(
        stage: &Stage<'a>,
        background: Option<&Field>,
        day: &Daylight,
        centres: &[DVec3],
    ) -> Self {
        let region = stage.region;
        let mut sunlit = Self {
            region,
            sun: day.sun_direction_local,
            parts: BTreeMap::new(),
        };
        let (Some(background), Some([shade, sun])) = (background, day.ground_ln_light) else {
            return sunlit;
        };
        let near = |cell: &usize| {
            let at = region.centre(*cell);
            let within = |c: &DVec3| (c.truncate() - at).abs().max_element() < AROUND_M;
            centres.iter().any(within)
        };
        let cells: Vec<usize> = (0..region.cells.len()).filter(near).collect();
        let pieces = look(background, stage.recording, region, &cells);
        let raw: BTreeMap<usize, f64> = cells
            .into_iter()
            .zip(pieces)
            .filter_map(|(cell, piece)| {
                let part = (piece?.ln_light() - shade) / (sun - shade);
                Some((cell, part))
            })
            .collect();
        sunlit.parts = raw
            .keys()
            .map(|cell| (*cell, smooth(sunlit.median_around(&raw, *cell))))
            .collect();
        sunlit
    }

    /// Median of the known cells around one: markings and patches are smaller.
    fn median_around(&self, raw: &BTreeMap<usize, f64>, cell: usize) -> f64 {
        let mut known = Vec::with_capacity(9);
        for y in -1..=1 {
            for x in -1..=1 {
                let step = DVec2::new(f64::from(x), f64::from(y)) * self.region.cell_m;
                let there = self.region.index_at(self.region.centre(cell) + step);
                known.extend(there.and_then(|c| raw.get(&c)));
            }
        }
        median(&mut known)
    }

    /// The part of the sun on the ground at a local point.
    pub(super) fn on_ground(&self, p: DVec3) -> Option<f64> {
        let cell = self.region.index_at(p.truncate())?;
        self.parts.get(&cell).copied()
    }

    /// The part of the sun that passes a local point: that of the ground on which the point's own shadow would fall.
    pub(super) fn through(&self, p: DVec3) -> Option<f64> {
        let mut foot = p;
        for _ in 0..2 {
            let ground = self.region.ground_height(foot.truncate())?;
            foot = p - self.sun * ((p.z - ground).max(0.0) / self.sun.z);
        }
        self.on_ground(foot)
    }
}

impl std::fmt::Debug for GroundSun<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "GroundSun of {} cells", self.parts.len())
    }
}

fn smooth(part: f64) -> f64 {
    let t = ((part - EDGE.0) / (EDGE.1 - EDGE.0)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// Upper median of a list that is not empty.
pub(super) fn median(values: &mut [f64]) -> f64 {
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}
