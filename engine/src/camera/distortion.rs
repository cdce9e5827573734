//! Lens distortion models, OpenCV conventions.

use glam::DVec2;
use serde::{Deserialize, Serialize};

/// Lens distortion applied to normalised image coordinates (x/z, y/z).
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub enum Distortion {
    #[default]
    None,
    /// k1, k2, p1, p2, k3 as in OpenCV's five-parameter model.
    BrownConrady { k: [f64; 5] },
    /// k1..k4 of OpenCV's fisheye model.
    KannalaBrandt { k: [f64; 4] },
}

impl Distortion {
    pub fn is_finite(&self) -> bool {
        match self {
            Self::None => true,
            Self::BrownConrady { k } => k.iter().all(|k| k.is_finite()),
            Self::KannalaBrandt { k } => k.iter().all(|k| k.is_finite()),
        }
    }

    /// Distorts normalised coordinates.
    pub fn distort(&self, n: DVec2) -> DVec2 {
        match *self {
            Self::None => n,
            Self::BrownConrady {
                k: [k1, k2, p1, p2, k3],
            } => {
                let r2 = n.length_squared();
                let radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
                DVec2::new(
                    n.x * radial + 2.0 * p1 * n.x * n.y + p2 * (r2 + 2.0 * n.x * n.x),
                    n.y * radial + p1 * (r2 + 2.0 * n.y * n.y) + 2.0 * p2 * n.x * n.y,
                )
            }
            Self::KannalaBrandt {
                k: [k1, k2, k3, k4],
            } => {
                let r = n.length();
                if r < 1e-12 {
                    return n;
                }
                let theta = libm::atan(r);
                let t2 = theta * theta;
                let distorted = theta * (1.0 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4))));
                n * (distorted / r)
            }
        }
    }

    /// Inverts [`Self::distort`] by fixed-point iteration (Brown-Conrady) or Newton steps (Kannala-Brandt).
    pub fn undistort(&self, d: DVec2) -> DVec2 {
        match *self {
            Self::None => d,
            Self::BrownConrady { .. } => {
                let mut n = d;
                // Converges linearly; 40 steps reach 1e-12 for every lens a car carries.
                for _ in 0..40 {
                    n += d - self.distort(n);
                }
                n
            }
            Self::KannalaBrandt {
                k: [k1, k2, k3, k4],
            } => {
                let target = d.length();
                if target < 1e-12 {
                    return d;
                }
                let mut theta = target;
                for _ in 0..20 {
                    let t2 = theta * theta;
                    let f = theta * (1.0 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4)))) - target;
                    let slope =
                        1.0 + t2 * (3.0 * k1 + t2 * (5.0 * k2 + t2 * (7.0 * k3 + t2 * 9.0 * k4)));
                    theta -= f / slope;
                }
                d * (libm::tan(theta) / target)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn undistort_inverts_distort() {
        let models = [
            Distortion::BrownConrady {
                k: [-0.37, 0.2, 0.001, -0.0007, -0.07],
            },
            Distortion::KannalaBrandt {
                k: [0.02, -0.004, 0.001, -0.0002],
            },
        ];
        for model in models {
            for (x, y) in [(0.0, 0.0), (0.3, -0.2), (-0.5, 0.25), (0.6, 0.1)] {
                let n = DVec2::new(x, y);
                let back = model.undistort(model.distort(n));
                assert!((back - n).length() < 1e-9, "{model:?} {n} {back}");
            }
        }
    }
}
