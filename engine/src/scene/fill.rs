//! Fills what nobody saw from what was seen around it: a smooth surface through the known pixels with their grain on it.
//!
//! The surface is the harmonic one (Laplace's equation with the known pixels as boundary), found on a pyramid by push-pull
//! and relaxed at full size. Near ground is held together along the rows more than along the columns.

use super::patches::{Canvas, texture};
use super::random::Draws;
use super::rows::continue_rows;

/// What is filled at once: sRGB and inverse camera z.
pub(super) type Texel = [f32; 4];

/// What a pixel is to the filling.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Part {
    /// Its texel is a source.
    Known,
    /// Its texel is replaced by texture.
    Hole,
    /// Its texel is replaced by the smooth surface with grain: near ground, which has nothing else.
    Smooth,
    /// Neither: it belongs to something that stands there.
    Barrier,
}

/// Texture is copied from this far around the hole's bounds: sideways, up and down.
const TEXTURE_FROM_PX: (usize, usize) = (160, 24);
impl Part {
    pub(super) fn is_hole(self) -> bool {
        matches!(self, Self::Hole | Self::Smooth)
    }
}

/// Weight of the rows above and below a pixel of near ground against those beside it: what lies behind a hole does not run down it.
const COLUMN_WEIGHT: f32 = 0.03;
const SWEEPS: usize = 120;
/// Near-optimal over-relaxation for holes of tens of pixels.
const OVER_RELAXATION: f32 = 1.8;
/// Grain is taken from known pixels this near to a hole.
const GRAIN_RING_PX: usize = 12;

/// Replaces the texels of the hole; all others keep theirs bit by bit. A hole without a known pixel anywhere keeps its own.
pub(super) fn fill(width: usize, texels: &mut [Texel], parts: &[Part], grain: Draws) {
    assert_eq!(texels.len(), parts.len(), "one part a texel");
    if !parts.contains(&Part::Known) {
        return;
    }
    let known = |i: usize| f32::from(u8::from(parts[i] == Part::Known));
    let level = Level {
        width,
        height: texels.len() / width,
        texels: (0..texels.len())
            .map(|i| texels[i].map(|v| v * known(i)))
            .collect(),
        weights: (0..texels.len()).map(known).collect(),
    };
    let smooth = push_pull(level);
    for (i, texel) in smooth.texels.iter().enumerate() {
        if parts[i].is_hole() {
            texels[i] = *texel;
        }
    }
    continue_rows(width, texels, parts);
    relax(width, texels, parts);
    let mut draws = grain;
    let textured = add_texture(width, texels, parts, &mut draws);
    let grainy = |part: Part| part == Part::Smooth || (part == Part::Hole && !textured);
    add_grain(width, texels, parts, grainy, draws);
}

/// Copies texture into the hole from the cut-out around it; whether there was any.
fn add_texture(width: usize, texels: &mut [Texel], parts: &[Part], draws: &mut Draws) -> bool {
    let height = texels.len() / width;
    let hole = || (0..parts.len()).filter(|i| parts[*i] == Part::Hole);
    let (x_min, x_max) = (
        hole().map(|i| i % width).min(),
        hole().map(|i| i % width).max(),
    );
    let (y_min, y_max) = (
        hole().map(|i| i / width).min(),
        hole().map(|i| i / width).max(),
    );
    let (Some(left), Some(right), Some(top), Some(bottom)) = (x_min, x_max, y_min, y_max) else {
        return false;
    };
    let (aside, above) = TEXTURE_FROM_PX;
    let columns = left.saturating_sub(aside)..(right + aside + 1).min(width);
    let rows = top.saturating_sub(above)..(bottom + above + 1).min(height);
    let cut: Vec<usize> = rows
        .flat_map(|row| columns.clone().map(move |column| row * width + column))
        .collect();
    let mut canvas = Canvas {
        width: columns.len(),
        rgb: cut
            .iter()
            .map(|i| [texels[*i][0], texels[*i][1], texels[*i][2]])
            .collect(),
        parts: cut.iter().map(|i| parts[*i]).collect(),
    };
    let textured = texture(&mut canvas, draws);
    for (at, i) in cut.into_iter().enumerate() {
        if parts[i] == Part::Hole {
            texels[i][..3].copy_from_slice(&canvas.rgb[at]);
        }
    }
    textured
}

/// Weighted texels of one size.
struct Level {
    width: usize,
    height: usize,
    /// Times their weight.
    texels: Vec<Texel>,
    weights: Vec<f32>,
}

/// The level with every texel known: gaps come from the next coarser level.
fn push_pull(mut level: Level) -> Level {
    if level.width > 1 || level.height > 1 {
        let coarse = push_pull(halved(&level));
        for i in 0..level.texels.len() {
            let (x, y) = (i % level.width / 2, i / level.width / 2);
            let below = coarse.texels[y * coarse.width + x];
            let left = 1.0 - level.weights[i].min(1.0);
            let scale = level.weights[i].max(1.0).recip();
            for (value, below) in level.texels[i].iter_mut().zip(below) {
                *value = *value * scale + left * below;
            }
        }
    } else {
        let scale = level.weights[0].max(f32::MIN_POSITIVE).recip();
        level.texels[0] = level.texels[0].map(|v| v * scale);
    }
    level
}

fn halved(level: &Level) -> Level {
    let (width, height) = (level.width.div_ceil(2), level.height.div_ceil(2));
    let mut half = Level {
        width,
        height,
        texels: vec![[0.0; 4]; width * height],
        weights: vec![0.0; width * height],
    };
    for i in 0..level.texels.len() {
        let at = i / level.width / 2 * width + i % level.width / 2;
        half.weights[at] += level.weights[i];
        for (sum, value) in half.texels[at].iter_mut().zip(level.texels[i]) {
            *sum += value;
        }
    }
    // A whole block of known pixels counts no more than one: the surface is drawn by what lies around the hole.
    for (texel, weight) in half.texels.iter_mut().zip(&mut half.weights) {
        if *weight > 1.0 {
            *texel = texel.map(|v| v / *weight);
            *weight = 1.0;
        }
    }
    half
}

/// Successive over-relaxation of Laplace's equation in the hole, of near ground with less weight along columns; borders and barriers
/// let nothing through.
fn relax(width: usize, texels: &mut [Texel], parts: &[Part]) {
    let hole: Vec<usize> = (0..parts.len()).filter(|i| parts[*i].is_hole()).collect();
    for _ in 0..SWEEPS {
        for &i in &hole {
            let (mut sum, mut count) = ([0.0; 4], 0.0);
            for n in neighbours(width, parts.len(), i).filter(|n| parts[*n] != Part::Barrier) {
                let across = parts[i] == Part::Smooth && n.abs_diff(i) != 1;
                let weight = if across { COLUMN_WEIGHT } else { 1.0 };
                count += weight;
                for (sum, value) in sum.iter_mut().zip(texels[n]) {
                    *sum += weight * value;
                }
            }
            if count > 0.0 {
                for (value, sum) in texels[i].iter_mut().zip(sum) {
                    *value += OVER_RELAXATION * (sum / count - *value);
                }
            }
        }
    }
}

fn neighbours(width: usize, count: usize, i: usize) -> impl Iterator<Item = usize> {
    let x = i % width;
    [
        (x > 0).then(|| i.wrapping_sub(1)),
        (x + 1 < width).then_some(i + 1),
        i.checked_sub(width),
        (i + width < count).then_some(i + width),
    ]
    .into_iter()
    .flatten()
}

/// Puts the difference of near known pixels to their own neighbours' mean on the hole, so that it is as noisy as its surroundings.
fn add_grain(
    width: usize,
    texels: &mut [Texel],
    parts: &[Part],
    grainy: impl Fn(Part) -> bool,
    mut draws: Draws,
) {
    let ring = ring(width, parts);
    if ring.is_empty() {
        return;
    }
    for i in (0..parts.len()).filter(|i| grainy(parts[*i])) {
        let from = ring[draws.below(ring.len())];
        let grain = grain_at(width, texels, parts, from);
        for (value, grain) in texels[i].iter_mut().zip(grain) {
            *value = (*value * (1.0 + grain)).clamp(0.0, 1.0);
        }
    }
}

/// How far a known pixel differs from the mean of its known neighbours, as a part of that mean: shade has fainter grain than sun.
/// Edges are no grain: they give none.
fn grain_at(width: usize, texels: &[Texel], parts: &[Part], i: usize) -> [f32; 3] {
    const EDGE: f32 = 0.15;
    /// Of less, the recorded steps of 1/255 would be taken for grain.
    const DARKEST: f32 = 0.05;
    let (mut sum, mut count) = ([0.0; 3], 0.0f32);
    for n in neighbours(width, parts.len(), i).filter(|n| parts[*n] == Part::Known) {
        count += 1.0;
        for (sum, value) in sum.iter_mut().zip(texels[n]) {
            *sum += value;
        }
    }
    let mean = sum.map(|s: f32| (s / count.max(1.0)).max(DARKEST));
    let grain: [f32; 3] = std::array::from_fn(|c| texels[i][c] / mean[c] - 1.0);
    let is_grain = count > 0.0 && grain.iter().all(|g| g.abs() < EDGE);
    if is_grain { grain } else { [0.0; 3] }
}

/// Known pixels near a hole, in order.
fn ring(width: usize, parts: &[Part]) -> Vec<usize> {
    let mut near: Vec<bool> = parts.iter().map(|p| p.is_hole()).collect();
    for _ in 0..GRAIN_RING_PX {
        let before = near.clone();
        for (i, near) in near.iter_mut().enumerate() {
            *near |= neighbours(width, parts.len(), i).any(|n| before[n]);
        }
    }
    (0..parts.len())
        .filter(|i| near[*i] && parts[*i] == Part::Known)
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const WIDTH: usize = 48;
    const HEIGHT: usize = 40;

    fn is_inside(i: usize) -> bool {
        let (x, y) = (i % WIDTH, i / WIDTH);
        (14..30).contains(&x) && (12..24).contains(&y)
    }

    fn scene(part: Part, texel: impl Fn(usize, usize) -> Texel) -> (Vec<Texel>, Vec<Part>) {
        let all = 0..WIDTH * HEIGHT;
        let truth = all.clone().map(|i| texel(i % WIDTH, i / WIDTH)).collect();
        let parts = all.map(|i| if is_inside(i) { part } else { Part::Known });
        (truth, parts.collect())
    }

    /// Fills a scene whose hole was blackened; the mean absolute error of the colours in it.
    fn error(fill: impl Fn(usize, &mut [Texel], &[Part]), truth: &[Texel], parts: &[Part]) -> f32 {
        let mut texels = truth.to_vec();
        let hole = || (0..parts.len()).filter(|i| parts[*i].is_hole());
        hole().for_each(|i| texels[i] = [0.0; 4]);
        fill(WIDTH, &mut texels, parts);
        for i in (0..parts.len()).filter(|i| !parts[*i].is_hole()) {
            assert_eq!(texels[i], truth[i], "a known texel changed");
        }
        let off = |i: usize| {
            (0..3)
                .map(|c| (texels[i][c] - truth[i][c]).abs())
                .sum::<f32>()
                / 3.0
        };
        hole().map(off).sum::<f32>() / hole().count() as f32
    }

    fn seeded(width: usize, texels: &mut [Texel], parts: &[Part]) {
        fill(width, texels, parts, Draws::new(3, 1, 0));
    }

    fn ramp(x: usize, y: usize) -> Texel {
        let v = 0.2 + 0.008 * x as f32 + 0.004 * y as f32;
        [v, 0.5 * v, 0.3, 0.1 * v]
    }

    fn stripes(x: usize, _: usize) -> Texel {
        if x % 8 < 4 {
            [0.9, 0.8, 0.1, 0.1]
        } else {
            [0.1, 0.2, 0.6, 0.1]
        }
    }

    #[test]
    fn a_smooth_hole_continues_a_ramp_and_keeps_what_is_known() {
        let (truth, parts) = scene(Part::Smooth, ramp);
        assert!(error(seeded, &truth, &parts) < 2e-3);
        // Not to be filled from: a barrier of another colour beside the hole.
        let mut walled = truth.clone();
        let mut barrier = parts.clone();
        for i in (0..parts.len()).filter(|i| i % WIDTH >= 30) {
            walled[i] = [1.0, 0.0, 0.0, 0.5];
            barrier[i] = Part::Barrier;
        }
        for i in (0..parts.len()).filter(|i| is_inside(*i)) {
            walled[i] = truth[i];
        }
        let kept_out = error(seeded, &walled, &barrier);
        assert!(kept_out < 0.05, "{kept_out}");
        let leaking: Vec<Part> = barrier
            .iter()
            .map(|p| if *p == Part::Barrier { Part::Known } else { *p })
            .collect();
        let leaked = error(seeded, &walled, &leaking);
        assert!(leaked > 1.5 * kept_out, "{leaked} {kept_out}");
    }

    #[test]
    fn near_ground_goes_on_along_its_rows_and_not_down_from_what_lies_behind() {
        // A road, and a blaze above the hole.
        let road = |x: usize, y: usize| match (12..30).contains(&x) && y < 12 {
            true => [1.0, 1.0, 1.0, 0.0],
            false => [0.3, 0.3, 0.32, 0.01 * y as f32],
        };
        let (truth, smooth) = scene(Part::Smooth, road);
        let along = error(seeded, &truth, &smooth);
        assert!(along < 0.04, "{along}");
        let (_, hole) = scene(Part::Hole, road);
        let harmonic = error(relax, &truth, &hole);
        assert!(harmonic > 3.0 * along, "{harmonic} {along}");
    }

    #[test]
    fn texture_goes_on_through_a_hole_where_a_smooth_surface_would_be_fog() {
        let (truth, textured) = scene(Part::Hole, stripes);
        let (_, smooth) = scene(Part::Smooth, stripes);
        let (sharp, fog) = (
            error(seeded, &truth, &textured),
            error(seeded, &truth, &smooth),
        );
        assert!(sharp < 0.05, "{sharp}");
        assert!(fog > 0.15, "{fog}");
    }

    #[test]
    fn a_filled_hole_is_as_noisy_as_its_surroundings_and_reproducible() {
        let noise = |x: usize, y: usize| {
            let g = 0.02 * (Draws::new(9, (y * WIDTH + x) as u64, 0).unit() as f32 - 0.5);
            [0.4 + g, 0.4 + g, 0.4 + g, 0.1]
        };
        let (truth, parts) = scene(Part::Smooth, noise);
        let run = |seed: u64| {
            let mut texels = truth.clone();
            fill(WIDTH, &mut texels, &parts, Draws::new(seed, 0, 0));
            texels
        };
        assert_eq!(run(1), run(1));
        assert_ne!(run(1), run(2));
        let spread = |texels: &[Texel]| {
            let hole: Vec<f32> = (0..parts.len())
                .filter(|i| parts[*i].is_hole())
                .map(|i| texels[i][0] - 0.4)
                .collect();
            (hole.iter().map(|g| g * g).sum::<f32>() / hole.len() as f32).sqrt()
        };
        let ratio = spread(&run(1)) / spread(&truth);
        assert!((0.6..1.7).contains(&ratio), "{ratio}");
    }

    #[test]
    fn a_fill_that_touches_known_pixels_is_noticed() {
        let (truth, parts) = scene(Part::Smooth, ramp);
        let blurring = |width: usize, texels: &mut [Texel], parts: &[Part]| {
            seeded(width, texels, parts);
            texels[0] = texels[1];
        };
        let noticed = std::panic::catch_unwind(|| error(blurring, &truth, &parts));
        assert!(noticed.is_err());
    }

    #[test]
    fn without_anything_known_nothing_changes() {
        let (truth, _) = scene(Part::Hole, ramp);
        let mut texels = truth.clone();
        seeded(WIDTH, &mut texels, &vec![Part::Hole; truth.len()]);
        assert_eq!(texels, truth);
    }
}
