//! The baseline that a background must beat: a neighbouring frame warped into a held-out view by exact depth.

use backlot_engine::camera::Rigid;
use glam::DVec2;

use super::render::{ExactFrame, View};

/// Warps `source` into `target` with the exact depth of `target`, by bilinear lookup.
///
/// Pixels of the target whose surface projects outside the source image take the nearest border pixel, and sky takes the direction's
/// pixel. Surfaces hidden in the source show whatever hides them: exact depth alone cannot know better.
pub fn warp_by_depth(source: (&View, &ExactFrame), target: (&View, &ExactFrame)) -> Vec<u8> {
    let (view, frame) = target;
    let source_from_target = source.0.world_from_camera.inverse() * view.world_from_camera;
    let mut warped = Vec::with_capacity(frame.rgb8.len());
    for y in 0..frame.height {
        for x in 0..frame.width {
            let depth = frame.depth_z_m[(y * frame.width + x) as usize];
            let pixel = DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5);
            warped.extend(look_up(source, &source_from_target, view, pixel, depth));
        }
    }
    warped
}

/// PSNR in dB between two sRGB images over the pixels where `counted` holds; infinite if they are equal, NaN if none counts.
pub fn psnr(a: &[u8], b: &[u8], counted: impl Fn(usize) -> bool) -> f64 {
    let (mut squares, mut values) = (0.0_f64, 0_u64);
    for (i, (pa, pb)) in a.chunks_exact(3).zip(b.chunks_exact(3)).enumerate() {
        if counted(i) {
            squares += pa
                .iter()
                .zip(pb)
                .map(|(&u, &v)| (f64::from(u) - f64::from(v)).powi(2))
                .sum::<f64>();
            values += 3;
        }
    }
    10.0 * (255.0_f64.powi(2) / (squares / values as f64)).log10()
}

fn look_up(
    source: (&View, &ExactFrame),
    source_from_target: &Rigid,
    view: &View,
    pixel: DVec2,
    depth: f32,
) -> [u8; 3] {
    let direction = view.camera.direction(pixel);
    let direction = direction / direction.z;
    let p_source = if depth.is_finite() {
        source_from_target.point(direction * f64::from(depth))
    } else {
        source_from_target.direction(direction)
    };
    let at = source.0.camera.project(p_source).unwrap_or(pixel);
    bilinear(source.1, at)
}

fn bilinear(frame: &ExactFrame, at: DVec2) -> [u8; 3] {
    let (width, height) = (frame.width as usize, frame.height as usize);
    let x = (at.x - 0.5).clamp(0.0, (width - 1) as f64);
    let y = (at.y - 0.5).clamp(0.0, (height - 1) as f64);
    let (x0, y0) = (x as usize, y as usize);
    let (x1, y1) = ((x0 + 1).min(width - 1), (y0 + 1).min(height - 1));
    let (fx, fy) = (x - x0 as f64, y - y0 as f64);
    std::array::from_fn(|c| {
        let value = |x: usize, y: usize| f64::from(frame.rgb8[(y * width + x) * 3 + c]);
        let top = value(x0, y0) * (1.0 - fx) + value(x1, y0) * fx;
        let bottom = value(x0, y1) * (1.0 - fx) + value(x1, y1) * fx;
        (top * (1.0 - fy) + bottom * fy).round() as u8
    })
}
