//! Comparing rendered frames.

use super::compare::{Cpu, Gpu};
use crate::scene::RenderedFrame;

/// Largest mean absolute difference of a channel, in 1/255.
const MEAN: f64 = 0.5;
/// Pixels with a channel that differs by more than [`FAR`] / 255: one in a thousand.
const FAR: i32 = 4;
const FAR_PIXELS: f64 = 1e-3;
/// Pixels whose depth differs by more than a hundredth of it: a ray through the rim of a surface has it before or behind the rim by
/// rounding. One in two hundred.
const DEPTH: f32 = 0.01;
const DEPTH_PIXELS: f64 = 5e-3;
/// Weights and accumulations differ by rounding and by a sample more or less at the face of an occupied cell.
const WEIGHT: f64 = 1e-3;
/// Instances are exact but for pixels whose depth differs as above, and those in which objects hold half of the weight within this.
const UNDECIDED: f32 = 5e-3;
/// Counts of pixels that an object would have alone, whose rims are undecided in the same way.
const COUNT: f64 = 2e-3;

/// What differs, for people.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct FrameDeviation {
    /// In 1/255.
    pub(super) mean: f64,
    pub(super) far_pixels: usize,
    pub(super) depth_pixels: usize,
    pub(super) mean_accumulation: f64,
    pub(super) mean_alpha: f64,
    pub(super) undecided: usize,
}

impl std::fmt::Display for FrameDeviation {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self {
            mean,
            far_pixels,
            depth_pixels,
            mean_accumulation,
            mean_alpha,
            undecided,
        } = self;
        write!(
            f,
            "colours differ by {mean:.5}/255 on average, {far_pixels} pixels by more than {FAR}/255; {depth_pixels} depths, \
             {undecided} undecided instances; accumulation by {mean_accumulation:.2e}, object weight by {mean_alpha:.2e}"
        )
    }
}

/// # Errors
/// Names the first quantity that differs by more than its tolerance.
pub(super) fn compare(
    gpu: &Gpu<RenderedFrame>,
    cpu: &Cpu<RenderedFrame>,
) -> Result<FrameDeviation, String> {
    let (gpu, cpu) = (&gpu.0, &cpu.0);
    if (gpu.width, gpu.height) != (cpu.width, cpu.height) {
        return Err("sizes differ".to_owned());
    }
    let pixels = cpu.instance.len() as f64;
    let found = FrameDeviation {
        mean: mean(
            gpu.rgb8
                .iter()
                .zip(&cpu.rgb8)
                .map(|(a, b)| f64::from(a.abs_diff(*b))),
        ),
        far_pixels: far_pixels(gpu, cpu),
        depth_pixels: depth_pixels(&gpu.depth_z_m, &cpu.depth_z_m)
            .max(depth_pixels(&gpu.behind_z_m, &cpu.behind_z_m)),
        mean_accumulation: mean_difference(&gpu.accumulation, &cpu.accumulation),
        mean_alpha: mean_difference(&gpu.placed_alpha, &cpu.placed_alpha),
        undecided: instances(gpu, cpu)?,
    };
    let within = [
        ("mean difference of colours", found.mean, MEAN),
        ("far pixels", found.far_pixels as f64 / pixels, FAR_PIXELS),
        (
            "pixels of other depth",
            found.depth_pixels as f64 / pixels,
            DEPTH_PIXELS,
        ),
        ("accumulation", found.mean_accumulation, WEIGHT),
        ("weight of the objects", found.mean_alpha, WEIGHT),
    ];
    for (what, value, bound) in within {
        if value.is_nan() || value >= bound {
            return Err(format!("{what}: {value} is not below {bound}; {found:?}"));
        }
    }
    counts(gpu, cpu)?;
    Ok(found)
}

fn mean(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    let count = values.len() as f64;
    values.sum::<f64>() / count
}

fn mean_difference(a: &[f32], b: &[f32]) -> f64 {
    mean(a.iter().zip(b).map(|(a, b)| f64::from((a - b).abs())))
}

fn far_pixels(gpu: &RenderedFrame, cpu: &RenderedFrame) -> usize {
    let pixels = gpu.rgb8.chunks(3).zip(cpu.rgb8.chunks(3));
    let far = |(a, b): &(&[u8], &[u8])| {
        let mut channels = a.iter().zip(*b);
        channels.any(|(a, b)| (i32::from(*a) - i32::from(*b)).abs() > FAR)
    };
    pixels.filter(far).count()
}

fn depth_pixels(a: &[f32], b: &[f32]) -> usize {
    let same = |(a, b): &(&f32, &f32)| (*a - *b).abs() <= DEPTH * b.abs();
    a.iter().zip(b).filter(|pair| !same(pair)).count()
}

/// Pixels of another instance that are undecided.
fn instances(gpu: &RenderedFrame, cpu: &RenderedFrame) -> Result<usize, String> {
    let mut undecided = 0;
    for (i, (a, b)) in gpu.instance.iter().zip(&cpu.instance).enumerate() {
        if a == b {
            continue;
        }
        let half = (cpu.placed_alpha[i] - 0.5).abs() < UNDECIDED;
        let surface = (gpu.depth_z_m[i] - cpu.depth_z_m[i]).abs() > DEPTH * cpu.depth_z_m[i];
        if !half && !surface {
            let (x, y) = (i as u32 % cpu.width, i as u32 / cpu.width);
            return Err(format!("pixel {x},{y} belongs to {a}, on the CPU to {b}"));
        }
        undecided += 1;
    }
    // Even undecided pixels are rims: few.
    let most = cpu.instance.len() / 2000 + 1;
    if undecided > most {
        return Err(format!(
            "{undecided} pixels of other instances, at most {most}"
        ));
    }
    Ok(undecided)
}

fn counts(gpu: &RenderedFrame, cpu: &RenderedFrame) -> Result<(), String> {
    let ids = |frame: &RenderedFrame| frame.alone_px.iter().map(|(id, _)| *id).collect::<Vec<_>>();
    if ids(gpu) != ids(cpu) {
        return Err("objects differ".to_owned());
    }
    for ((id, a), (_, b)) in gpu.alone_px.iter().zip(&cpu.alone_px) {
        let off = (f64::from(*a) - f64::from(*b)).abs();
        if off > 3.0 + COUNT * f64::from(*b) {
            return Err(format!(
                "object {id} would have {a} pixels alone, on the CPU {b}"
            ));
        }
    }
    let hidden = |frame: &RenderedFrame| {
        frame
            .hidden_px
            .values()
            .map(|px| f64::from(*px))
            .sum::<f64>()
    };
    let (a, b) = (hidden(gpu), hidden(cpu));
    if (a - b).abs() > 5.0 + COUNT * b {
        return Err(format!("{a} hidden pixels, on the CPU {b}"));
    }
    Ok(())
}
