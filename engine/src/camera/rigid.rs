//! Rigid transforms in f64.

use glam::{DMat3, DQuat, DVec3};
use serde::{Deserialize, Serialize};

/// A rigid transform `target_from_source`: `p_target = rotation * p_source + translation_m`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Rigid {
    /// Unit quaternion.
    pub rotation: DQuat,
    /// Metres, in the target frame.
    pub translation_m: DVec3,
}

impl Rigid {
    pub const IDENTITY: Self = Self {
        rotation: DQuat::IDENTITY,
        translation_m: DVec3::ZERO,
    };

    pub fn new(rotation: DQuat, translation_m: DVec3) -> Self {
        Self {
            rotation,
            translation_m,
        }
    }

    /// A pose from its heading about +z (0 = +x, turning left) and position.
    pub fn from_heading(heading_rad: f64, translation_m: DVec3) -> Self {
        // libm, because the platform's sine differs from machine to machine and placements must not.
        let (sin, cos) = libm::sincos(heading_rad * 0.5);
        Self::new(DQuat::from_xyzw(0.0, 0.0, sin, cos), translation_m)
    }

    pub fn inverse(&self) -> Self {
        let rotation = self.rotation.conjugate();
        Self::new(rotation, rotation * -self.translation_m)
    }

    /// Maps a point.
    pub fn point(&self, p_source: DVec3) -> DVec3 {
        self.rotation * p_source + self.translation_m
    }

    /// Maps a direction.
    pub fn direction(&self, d_source: DVec3) -> DVec3 {
        self.rotation * d_source
    }

    pub fn rotation_matrix(&self) -> DMat3 {
        DMat3::from_quat(self.rotation)
    }

    /// Heading of the source's x axis in the target's x-y plane, in (-pi, pi].
    pub fn heading_rad(&self) -> f64 {
        let x = self.rotation * DVec3::X;
        libm::atan2(x.y, x.x)
    }

    /// Interpolates from `self` (0) to `other` (1): linear in translation, slerp in rotation.
    pub fn interpolate(&self, other: &Self, fraction: f64) -> Self {
        Self::new(
            self.rotation.slerp(other.rotation, fraction),
            self.translation_m.lerp(other.translation_m, fraction),
        )
    }

    pub fn is_finite(&self) -> bool {
        self.rotation.is_finite() && self.translation_m.is_finite()
    }
}

/// `a_from_c = a_from_b * b_from_c`.
impl std::ops::Mul for Rigid {
    type Output = Self;

    fn mul(self, rhs: Self) -> Self {
        Self::new(self.rotation * rhs.rotation, self.point(rhs.translation_m))
    }
}
