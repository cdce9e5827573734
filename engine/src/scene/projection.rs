//! The image of a cuboid.

use glam::{DVec2, DVec3};

use crate::camera::{Camera, Distortion, NEAR_M, Rigid};

/// An axis-aligned box in continuous pixels, min inclusive, max exclusive.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PixelBox {
    pub min: DVec2,
    pub max: DVec2,
}

impl PixelBox {
    pub fn area_px(&self) -> f64 {
        let size = (self.max - self.min).max(DVec2::ZERO);
        size.x * size.y
    }

    /// The part inside the image; `None` if there is none.
    pub fn clipped(&self, camera: &Camera) -> Option<Self> {
        let image = DVec2::new(f64::from(camera.width), f64::from(camera.height));
        let clipped = Self {
            min: self.min.max(DVec2::ZERO),
            max: self.max.min(image),
        };
        (clipped.min.cmplt(clipped.max).all()).then_some(clipped)
    }

    /// Fraction of the box outside the image, 0..=1.
    pub fn truncation(&self, camera: &Camera) -> f64 {
        let inside = self.clipped(camera).map_or(0.0, |b| b.area_px());
        (1.0 - inside / self.area_px()).clamp(0.0, 1.0)
    }
}

/// Straight edges stay straight without distortion; otherwise this many chords follow the curve to under 0.05 px.
const DISTORTED_CHORDS: u32 = 32;

/// Bounds of the projection of a cuboid whose part nearer than [`NEAR_M`] is cut off (not only its corners: an edge that
/// crosses the near plane is cut there). May reach outside the image; `None` if everything is nearer.
pub fn amodal_box(camera: &Camera, camera_from_cuboid: &Rigid, size_m: DVec3) -> Option<PixelBox> {
    box_of_corners(camera, &corners(camera_from_cuboid, size_m))
}

/// [`amodal_box`] of a box by its corners in the camera frame, ordered as in [`corners`].
pub(super) fn box_of_corners(camera: &Camera, corners: &[DVec3; 8]) -> Option<PixelBox> {
    let chords = match camera.distortion {
        Distortion::None => 1,
        _ => DISTORTED_CHORDS,
    };
    let mut bounds: Option<PixelBox> = None;
    for (from, to) in EDGES {
        let Some((a, b)) = cut_near(corners[from], corners[to]) else {
            continue;
        };
        for i in 0..=chords {
            let p = a.lerp(b, f64::from(i) / f64::from(chords));
            // Rounding may put the cut a hair before the near plane.
            let Some(pixel) = camera.project(p.with_z(p.z.max(NEAR_M))) else {
                continue;
            };
            let grown = bounds.map_or((pixel, pixel), |b| (b.min.min(pixel), b.max.max(pixel)));
            bounds = Some(PixelBox {
                min: grown.0,
                max: grown.1,
            });
        }
    }
    bounds
}

/// The corners in the target frame; bit 0 of the index is x, bit 1 is y, bit 2 is z.
pub fn corners(target_from_cuboid: &Rigid, size_m: DVec3) -> [DVec3; 8] {
    std::array::from_fn(|i| {
        let sign = |bit: usize| if i >> bit & 1 == 1 { 0.5 } else { -0.5 };
        target_from_cuboid.point(DVec3::new(sign(0), sign(1), sign(2)) * size_m)
    })
}

const EDGES: [(usize, usize); 12] = [
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

fn cut_near(a: DVec3, b: DVec3) -> Option<(DVec3, DVec3)> {
    match (a.z >= NEAR_M, b.z >= NEAR_M) {
        (true, true) => Some((a, b)),
        (false, false) => None,
        (true, false) => Some((a, a.lerp(b, (a.z - NEAR_M) / (a.z - b.z)))),
        (false, true) => Some((b.lerp(a, (b.z - NEAR_M) / (b.z - a.z)), b)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DQuat;
    use proptest::prelude::*;

    fn camera() -> Camera {
        Camera {
            width: 640,
            height: 384,
            focal_px: DVec2::new(400.0, 410.0),
            principal_px: DVec2::new(318.0, 190.0),
            distortion: Distortion::None,
        }
    }

    /// Projects a fine grid on the faces, near part left out.
    fn brute_force(camera: &Camera, pose: &Rigid, size: DVec3) -> Option<PixelBox> {
        let steps = 240;
        let mut bounds: Option<PixelBox> = None;
        for axis in 0..3 {
            for side in [-0.5, 0.5] {
                for i in 0..=steps {
                    for j in 0..=steps {
                        let at = |k: i32| f64::from(k) / f64::from(steps) - 0.5;
                        let mut p = [0.0; 3];
                        p[axis] = side;
                        p[(axis + 1) % 3] = at(i);
                        p[(axis + 2) % 3] = at(j);
                        let Some(q) = camera.project(pose.point(DVec3::from_array(p) * size))
                        else {
                            continue;
                        };
                        let b = bounds.get_or_insert(PixelBox { min: q, max: q });
                        (b.min, b.max) = (b.min.min(q), b.max.max(q));
                    }
                }
            }
        }
        bounds
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(32))]
        #[test]
        fn agrees_with_brute_force(
            x in -8.0f64..8.0, y in -2.0f64..3.0, z in 4.0f64..40.0, yaw in -3.2f64..3.2, pitch in -0.1f64..0.1,
        ) {
            let pose = Rigid::new(
                DQuat::from_rotation_y(yaw) * DQuat::from_rotation_x(pitch - 1.5),
                DVec3::new(x, y, z),
            );
            let size = DVec3::new(4.5, 1.9, 1.6);
            let exact = amodal_box(&camera(), &pose, size).unwrap();
            let brute = brute_force(&camera(), &pose, size).unwrap();
            prop_assert!((exact.min - brute.min).abs().max_element() < 0.1);
            prop_assert!((exact.max - brute.max).abs().max_element() < 0.1);
        }
    }

    #[test]
    fn a_box_beside_the_camera_does_not_flip() {
        // From 1 m behind to 3 m before the camera, left of it: clipping only corners would put it right or lose it.
        let pose = Rigid::new(DQuat::IDENTITY, DVec3::new(-2.0, 0.5, 1.0));
        let found = amodal_box(&camera(), &pose, DVec3::new(1.0, 1.0, 4.0)).unwrap();
        assert!(found.max.x < 318.0 && found.min.x < -5000.0, "{found:?}");
        assert!(found.truncation(&camera()) > 0.9);
        let behind = Rigid::new(DQuat::IDENTITY, DVec3::new(0.0, 0.0, -5.0));
        assert!(amodal_box(&camera(), &behind, DVec3::ONE).is_none());
    }
}
