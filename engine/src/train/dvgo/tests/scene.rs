//! A ball with coloured octants before white, seen from all around.

use glam::{DMat3, DQuat, DVec2, DVec3};

use crate::camera::{Camera, Distortion, Rigid};
use crate::view::{PixelLabel, Split, TrainView};

/// Radius of the ball and distance of the cameras from its centre, in metres.
const RADIUS_M: f64 = 0.8;
pub(super) const DISTANCE_M: f64 = 4.0;

/// A view from `eye` towards the origin.
pub(super) fn view(eye: DVec3, size: u32, split: Split) -> TrainView {
    let forward = -eye.normalize();
    let right = forward.cross(DVec3::Z).normalize();
    let axes = DMat3::from_cols(right, forward.cross(right), forward);
    let camera = Camera {
        width: size,
        height: size,
        focal_px: DVec2::splat(1.4 * f64::from(size)),
        principal_px: DVec2::splat(f64::from(size) / 2.0),
        distortion: Distortion::None,
    };
    let local_from_camera = Rigid::new(DQuat::from_mat3(&axes), eye);
    let pixels = (0..size).flat_map(|y| (0..size).map(move |x| (x, y)));
    let rgb = pixels.flat_map(|(x, y)| {
        let pixel = DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5);
        color(eye, local_from_camera.direction(camera.direction(pixel)))
    });
    TrainView {
        frame_index: 0,
        camera,
        local_from_camera,
        rgb: rgb.collect(),
        labels: vec![PixelLabel::Foreground; (size * size) as usize],
        depth: Vec::new(),
        split,
    }
}

fn color(eye: DVec3, direction: DVec3) -> [u8; 3] {
    let b = eye.dot(direction);
    let c = eye.length_squared() - RADIUS_M * RADIUS_M;
    let root = b * b - c;
    if root < 0.0 {
        return [255; 3];
    }
    let p = eye + direction * (-b - root.sqrt());
    [p.x, p.y, p.z].map(|x| if x > 0.0 { 200 } else { 60 })
}

/// `count` views spread over the sphere of directions, those beyond `train` held out.
pub(super) fn views(train: usize, held_out: usize, size: u32) -> Vec<TrainView> {
    let count = train + held_out;
    (0..count)
        .map(|number| {
            // Fibonacci's lattice, in an order that spreads the held-out views.
            let at = (number * 7) % count;
            let z = 0.9 - 1.8 * (at as f64 + 0.5) / count as f64;
            let heading = at as f64 * 2.399_963;
            let flat = (1.0 - z * z).sqrt();
            let eye = DVec3::new(flat * heading.cos(), flat * heading.sin(), z) * DISTANCE_M;
            let split = if number < train {
                Split::Train
            } else {
                Split::HeldOut
            };
            view(eye, size, split)
        })
        .collect()
}
