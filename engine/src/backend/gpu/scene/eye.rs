//! The camera as kernels take it.

use backlot_shaders::scene_layout::EyeParams;
use glam::DVec3;

use crate::camera::{Camera, Distortion, Rigid};

/// A camera in a field's frame; its rays end at the optical depth `stop_tau`.
pub(super) fn eye_params(camera: &Camera, field_from_camera: &Rigid, stop_tau: f32) -> EyeParams {
    let column = |axis: DVec3| field_from_camera.direction(axis).as_vec3().to_array();
    let (distortion, k, k3) = match camera.distortion {
        Distortion::None => (0, [0.0; 4], 0.0),
        Distortion::BrownConrady {
            k: [k1, k2, p1, p2, k3],
        } => (1, [k1, k2, p1, p2], k3),
        Distortion::KannalaBrandt { k } => (2, k, 0.0),
    };
    EyeParams {
        right: column(DVec3::X),
        focal_x_px: camera.focal_px.x as f32,
        down: column(DVec3::Y),
        focal_y_px: camera.focal_px.y as f32,
        forward: column(DVec3::Z),
        principal_x_px: camera.principal_px.x as f32,
        origin_m: field_from_camera.translation_m.as_vec3().to_array(),
        principal_y_px: camera.principal_px.y as f32,
        k: k.map(|k| k as f32),
        k3: k3 as f32,
        distortion,
        stop_tau,
        ..Default::default()
    }
}
