//! Geometry between the engine's types and the wire's.

use backlot_engine::camera::{Camera, Distortion, Rigid};
use backlot_proto::v1;
use glam::{DQuat, DVec2, DVec3};

pub fn vector_to_wire(v: DVec3) -> v1::Vector3 {
    v1::Vector3 {
        x: v.x,
        y: v.y,
        z: v.z,
    }
}

/// An absent vector is the zero vector.
pub fn vector_from_wire(v: Option<&v1::Vector3>) -> DVec3 {
    v.map_or(DVec3::ZERO, |v| DVec3::new(v.x, v.y, v.z))
}

pub fn rigid_to_wire(rigid: &Rigid) -> v1::RigidTransform {
    v1::RigidTransform {
        rotation: Some(v1::Quaternion {
            w: rigid.rotation.w,
            x: rigid.rotation.x,
            y: rigid.rotation.y,
            z: rigid.rotation.z,
        }),
        translation_m: Some(vector_to_wire(rigid.translation_m)),
    }
}

/// An absent transform, or an absent part of it, is the identity.
pub fn rigid_from_wire(rigid: Option<&v1::RigidTransform>) -> Rigid {
    let Some(rigid) = rigid else {
        return Rigid::IDENTITY;
    };
    let rotation = rigid.rotation.as_ref().map_or(DQuat::IDENTITY, |q| {
        DQuat::from_xyzw(q.x, q.y, q.z, q.w).normalize()
    });
    Rigid::new(rotation, vector_from_wire(rigid.translation_m.as_ref()))
}

/// A camera of the manifest; no distortion is an absent one.
pub fn camera_to_wire(camera_id: &str, camera: &Camera, ego_from_camera: &Rigid) -> v1::Camera {
    let distortion = match camera.distortion {
        Distortion::None => None,
        Distortion::BrownConrady { k } => Some((v1::DistortionModel::BrownConrady, k.to_vec())),
        Distortion::KannalaBrandt { k } => Some((v1::DistortionModel::KannalaBrandt, k.to_vec())),
    };
    v1::Camera {
        camera_id: camera_id.to_owned(),
        width: camera.width,
        height: camera.height,
        focal_x_px: camera.focal_px.x,
        focal_y_px: camera.focal_px.y,
        principal_x_px: camera.principal_px.x,
        principal_y_px: camera.principal_px.y,
        distortion: distortion.map(|(model, coefficients)| v1::Distortion {
            model: model.into(),
            coefficients,
        }),
        ego_from_camera: Some(rigid_to_wire(ego_from_camera)),
    }
}

/// The model of a camera of the manifest; `None` if its distortion has the wrong number of coefficients.
pub fn camera_from_wire(camera: &v1::Camera) -> Option<Camera> {
    let distortion = match &camera.distortion {
        None => Distortion::None,
        Some(given) => match given.model() {
            v1::DistortionModel::Unspecified => Distortion::None,
            v1::DistortionModel::BrownConrady => Distortion::BrownConrady {
                k: given.coefficients.as_slice().try_into().ok()?,
            },
            v1::DistortionModel::KannalaBrandt => Distortion::KannalaBrandt {
                k: given.coefficients.as_slice().try_into().ok()?,
            },
        },
    };
    Some(Camera {
        width: camera.width,
        height: camera.height,
        focal_px: DVec2::new(camera.focal_x_px, camera.focal_y_px),
        principal_px: DVec2::new(camera.principal_x_px, camera.principal_y_px),
        distortion,
    })
}

/// The camera model of a rendered view, which has no distortion.
pub fn camera_of_view(view: &v1::CameraView) -> Camera {
    Camera {
        width: view.width,
        height: view.height,
        focal_px: DVec2::new(view.focal_x_px, view.focal_y_px),
        principal_px: DVec2::new(view.principal_x_px, view.principal_y_px),
        distortion: Distortion::None,
    }
}

/// The eight corners of a box of `size_m` (length, width, height) in its own centred frame, in metres.
///
/// Bit 0 of the index chooses the front (+x), bit 1 the left (+y), bit 2 the top (+z).
pub fn box_corners(size_m: DVec3) -> [DVec3; 8] {
    std::array::from_fn(|i| {
        let side = |bit: usize| if i >> bit & 1 == 1 { 0.5 } else { -0.5 };
        size_m * DVec3::new(side(0), side(1), side(2))
    })
}

/// Corner pairs of [`box_corners`] joined by an edge.
pub const BOX_EDGES: [(usize, usize); 12] = [
    (0, 1),
    (2, 3),
    (4, 5),
    (6, 7),
    (0, 2),
    (1, 3),
    (4, 6),
    (5, 7),
    (0, 4),
    (1, 5),
    (2, 6),
    (3, 7),
];
