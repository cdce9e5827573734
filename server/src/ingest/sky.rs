//! Sky in images of logs that bring no sky mask.
//!
//! Bright, smooth regions above the horizon that no LiDAR return falls on: overexposed white or clear blue. What is doubtful
//! (overcast grey, sky between leaves) stays unlabelled, which costs nothing but the push towards empty space.

use backlot_engine::camera::{Camera, Rigid};
use backlot_engine::view::DepthSource;
use glam::DVec2;

use super::projected::ProjectedReturn;

/// Every channel at least this bright is overexposed sky.
const WHITE: u8 = 225;
/// Blue sky: blue exceeds red by this and is not dark.
const BLUE_OVER_RED: u8 = 20;
const BLUE_LEAST: u8 = 110;
/// Neighbouring sky pixels differ by less than this.
const SMOOTH: u8 = 12;
/// A region that does not touch the upper border must be this large, in thousandths of the image.
const ISLAND_THOUSANDTHS: usize = 1;
/// Sine of the least elevation; distant ground and its haze lie below.
const LEAST_ELEVATION: f64 = 0.01;

/// The sky pixels of an sRGB image, row-major. `world_from_camera` gives the horizon (world z is up).
pub(super) fn find_sky(
    rgb: &[u8],
    camera: &Camera,
    world_from_camera: &Rigid,
    returns: &[ProjectedReturn],
) -> Vec<bool> {
    let (width, height) = (camera.width as usize, camera.height as usize);
    let mut solid = vec![false; width * height];
    // Monocular maps give the sky a depth too.
    for r in returns.iter().filter(|r| r.source == DepthSource::Lidar) {
        solid[r.pixel.y as usize * width + r.pixel.x as usize] = true;
    }
    let candidate = candidates(rgb, camera, world_from_camera);
    let least = width * height * ISLAND_THOUSANDTHS / 1_000;
    let mut sky = vec![false; width * height];
    let mut seen = vec![false; width * height];
    let mut region = Vec::new();
    for start in 0..width * height {
        if seen[start] || !candidate[start] {
            continue;
        }
        flood(start, width, rgb, &candidate, &mut seen, &mut region);
        let is_open = region.iter().any(|&p| p < width) || region.len() >= least.max(1);
        if is_open && !region.iter().any(|&p| solid[p]) {
            region.iter().for_each(|&p| sky[p] = true);
        }
    }
    sky
}

fn candidates(rgb: &[u8], camera: &Camera, world_from_camera: &Rigid) -> Vec<bool> {
    let width = camera.width as usize;
    rgb.chunks_exact(3)
        .enumerate()
        .map(|(i, p)| {
            let (r, g, b) = (p[0], p[1], p[2]);
            let white = r.min(g).min(b) >= WHITE;
            let blue = b >= BLUE_LEAST && b >= g && b >= r.saturating_add(BLUE_OVER_RED);
            (white || blue) && {
                let pixel = DVec2::new((i % width) as f64 + 0.5, (i / width) as f64 + 0.5);
                world_from_camera.direction(camera.direction(pixel)).z > LEAST_ELEVATION
            }
        })
        .collect()
}

/// Collects the smooth region around `start` into `region`.
fn flood(
    start: usize,
    width: usize,
    rgb: &[u8],
    candidate: &[bool],
    seen: &mut [bool],
    region: &mut Vec<usize>,
) {
    let is_smooth =
        |a: usize, b: usize| (0..3).all(|c| rgb[3 * a + c].abs_diff(rgb[3 * b + c]) < SMOOTH);
    region.clear();
    region.push(start);
    seen[start] = true;
    let mut next = 0;
    while let Some(&at) = region.get(next) {
        next += 1;
        let x = at % width;
        let neighbours = [
            (x > 0).then(|| at - 1),
            (x + 1 < width).then_some(at + 1),
            at.checked_sub(width),
            (at + width < candidate.len()).then_some(at + width),
        ];
        for near in neighbours.into_iter().flatten() {
            if candidate[near] && !seen[near] && is_smooth(at, near) {
                seen[near] = true;
                region.push(near);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use backlot_engine::camera::Distortion;
    use glam::{DQuat, DVec3};

    fn street() -> (Vec<u8>, Camera, Rigid) {
        let camera = Camera {
            width: 80,
            height: 60,
            focal_px: DVec2::splat(80.0),
            principal_px: DVec2::new(40.0, 30.0),
            distortion: Distortion::None,
        };
        // Blue above row 20, a white wall from row 20 on at columns 60.., grey elsewhere.
        let pixel = |x: usize, y: usize| match (x, y) {
            (_, ..20) => [120, 170, 230],
            (60.., _) => [240, 240, 240],
            _ => [90, 90, 90],
        };
        let rgb = (0..60)
            .flat_map(|y| (0..80).flat_map(move |x| pixel(x, y)))
            .collect();
        let rotation = DQuat::from_xyzw(-0.5, 0.5, -0.5, 0.5);
        (rgb, camera, Rigid::new(rotation, DVec3::ZERO))
    }

    #[test]
    fn blue_above_is_sky_and_a_white_wall_with_returns_is_not() {
        let (rgb, camera, pose) = street();
        let wall = ProjectedReturn {
            pixel: DVec2::new(70.5, 25.5),
            range_m: 20.0,
            world_m: DVec3::ZERO,
            origin_m: DVec3::ZERO,
            owner: None,
            occluded: false,
            source: DepthSource::Lidar,
            weight: 1.0,
        };
        let sky = find_sky(&rgb, &camera, &pose, &[wall]);
        assert_eq!(sky.iter().filter(|&&s| s).count(), 20 * 80);
        assert!(sky[..20 * 80].iter().all(|&s| s));
    }

    #[test]
    fn nothing_below_the_horizon_is_sky() {
        let (rgb, camera, _) = street();
        // Looking down.
        let pose = Rigid::new(DQuat::from_rotation_x(std::f64::consts::PI), DVec3::ZERO);
        assert!(find_sky(&rgb, &camera, &pose, &[]).iter().all(|&s| !s));
    }
}
