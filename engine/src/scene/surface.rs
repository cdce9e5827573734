//! The placed surface that a pixel shows, with its normal.

use glam::{DVec2, DVec3, Vec3};

use super::render::Scene;
use crate::field::{Field, RaySample};

/// A surface in the frame of the object it belongs to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Surface {
    /// Index into [`Scene::objects`].
    pub(super) object: usize,
    pub(super) position: DVec3,
    /// Unit vector, facing the camera.
    pub(super) normal: DVec3,
}

/// March until less than a hundredth of the light is left.
const STOP_TAU: f32 = 4.6;
/// An object that takes less of a ray has no surface there.
const LEAST_ALPHA: f32 = 0.02;
/// Normals are slopes over this: two voxels of an object, so that their noise averages out.
const SLOPE_M: f32 = 0.1;

/// The nearest placed surface on the ray through a pixel position: where half of the light that an object takes is gone.
pub(super) fn nearest_surface(
    scene: &Scene<'_>,
    pixel: DVec2,
    samples: &mut Vec<RaySample>,
) -> Option<Surface> {
    let direction = scene.camera.direction(pixel);
    let direction = scene.local_from_camera.direction(direction).normalize();
    let eye = scene.local_from_camera.translation_m;
    let mut nearest: Option<(f32, Surface)> = None;
    for (index, object) in scene.objects.iter().enumerate() {
        let to_object = object.local_from_object.inverse();
        let (from, along) = (to_object.point(eye), to_object.direction(direction));
        let (from, along) = (from.as_vec3(), along.as_vec3());
        let Some(t) = middle(object.field, from, along, samples) else {
            continue;
        };
        if nearest.is_none_or(|(best, _)| t < best) {
            let position = from + along * t;
            let surface = Surface {
                object: index,
                position: position.as_dvec3(),
                normal: normal(object.field, position, along).as_dvec3(),
            };
            nearest = Some((t, surface));
        }
    }
    nearest.map(|(_, surface)| surface)
}

/// Distance at which a field has taken half of what it takes of a ray's light.
fn middle(
    field: &Field,
    origin: Vec3,
    direction: Vec3,
    samples: &mut Vec<RaySample>,
) -> Option<f32> {
    samples.clear();
    let tau = field.march(origin, direction, 0.0, f32::INFINITY, STOP_TAU, samples);
    let alpha = -(-tau).exp_m1();
    if alpha < LEAST_ALPHA {
        return None;
    }
    let half = -(-0.5 * alpha).ln_1p();
    let mut passed = 0.0;
    samples.iter().find_map(|sample| {
        let step = sample.sigma * sample.dt;
        passed += step;
        (passed >= half).then(|| {
            let within = 1.0 - (passed - half) / step;
            sample.t + (within - 0.5) * sample.dt
        })
    })
}

/// Against the slope of opacity; towards the camera where there is none.
fn normal(field: &Field, p: Vec3, direction: Vec3) -> Vec3 {
    let opacity = |offset: Vec3| -(-field.sigma(p + offset) * SLOPE_M).exp_m1();
    let slope = |axis: Vec3| opacity(-axis * SLOPE_M) - opacity(axis * SLOPE_M);
    let outward = Vec3::new(slope(Vec3::X), slope(Vec3::Y), slope(Vec3::Z));
    // What is seen faces the camera; noise must not turn it away.
    let away = outward.dot(direction).max(0.0);
    (outward - direction * away)
        .try_normalize()
        .unwrap_or(-direction)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Rigid;
    use crate::scene::box_world::{camera, forward_from_camera};
    use crate::scene::render::SceneObject;
    use crate::scene::solid_field::solid_field;
    use crate::scene::tone::Tone;
    use std::sync::Arc;

    #[test]
    fn the_front_of_the_nearer_box_faces_the_camera() {
        let half = Vec3::new(2.0, 1.0, 0.75);
        let solid = |p: Vec3| if p.abs().cmple(half).all() { 80.0 } else { 0.0 };
        let field = Arc::new(solid_field(-half - 0.3, half + 0.3, 0.1, [0.5; 3], solid));
        let at = |id: u16, x: f64, heading: f64| SceneObject {
            instance_id: id,
            field: &field,
            local_from_object: Rigid::from_heading(heading, DVec3::new(x, 0.0, 0.75)),
            size_m: DVec3::new(4.0, 2.0, 1.5),
            tone: Tone::IDENTITY,
        };
        let quarter = std::f64::consts::FRAC_PI_2;
        let scene = Scene {
            background: None,
            objects: vec![at(1, 20.0, 0.0), at(2, 10.0, quarter)],
            statics: Vec::new(),
            camera: camera(),
            local_from_camera: Rigid::new(forward_from_camera(), DVec3::new(0.0, 0.3, 1.0)),
        };
        let centre = scene.camera.principal_px;
        let surface = nearest_surface(&scene, centre, &mut Vec::new()).expect("boxes are ahead");
        assert_eq!(surface.object, 1);
        // Turned left by a quarter, the box shows its left side, which lies 9 m ahead.
        assert!(surface.normal.dot(DVec3::Y) > 0.98, "{}", surface.normal);
        let local = scene.objects[1].local_from_object.point(surface.position);
        assert!((local.x - 9.0).abs() < 0.1, "{local}");
        let above = centre - DVec2::Y * 100.0;
        assert!(nearest_surface(&scene, above, &mut Vec::new()).is_none());
    }
}
