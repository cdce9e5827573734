//! Pinhole camera with lens distortion.

use glam::{DVec2, DVec3};
use serde::{Deserialize, Serialize};

use super::Distortion;
use crate::{Error, Result};

/// Points nearer than this along the optical axis are not projected; boxes are clipped here.
pub const NEAR_M: f64 = 0.1;

/// A camera in the OpenCV frame: x right, y down, z forward. The centre of the top left pixel is (0.5, 0.5).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Camera {
    pub width: u32,
    pub height: u32,
    pub focal_px: DVec2,
    pub principal_px: DVec2,
    pub distortion: Distortion,
}

impl Camera {
    /// Checks sizes, focal lengths and finiteness, distortion included.
    ///
    /// # Errors
    /// [`Error::Invalid`] naming the field; `context` is put in front, e.g. "camera image_02".
    pub fn validate(&self, context: &str) -> Result<()> {
        if self.width == 0 || self.height == 0 || self.width > 16_384 || self.height > 16_384 {
            return Err(Error::invalid(format!(
                "{context}: image size {}x{} is outside 1..=16384",
                self.width, self.height
            )));
        }
        let focal_ok = self.focal_px.is_finite() && self.focal_px.x > 0.0 && self.focal_px.y > 0.0;
        if !focal_ok {
            return Err(Error::invalid(format!(
                "{context}: focal length {} must be finite and positive",
                self.focal_px
            )));
        }
        if !self.principal_px.is_finite() {
            return Err(Error::invalid(format!(
                "{context}: principal point {} must be finite",
                self.principal_px
            )));
        }
        if !self.distortion.is_finite() {
            return Err(Error::invalid(format!(
                "{context}: distortion {:?} must be finite",
                self.distortion
            )));
        }
        Ok(())
    }

    /// The unit direction in the camera frame of the continuous pixel position.
    pub fn direction(&self, pixel: DVec2) -> DVec3 {
        let n = self
            .distortion
            .undistort((pixel - self.principal_px) / self.focal_px);
        DVec3::new(n.x, n.y, 1.0).normalize()
    }

    /// Pixel position of a point in the camera frame; `None` nearer than [`NEAR_M`]. May lie outside the image.
    pub fn project(&self, p_camera: DVec3) -> Option<DVec2> {
        if p_camera.z.is_nan() || p_camera.z < NEAR_M {
            return None;
        }
        let n = self.distortion.distort(p_camera.truncate() / p_camera.z);
        Some(n * self.focal_px + self.principal_px)
    }

    /// The same camera with its image resized to `width` x `height`.
    pub fn resized(&self, width: u32, height: u32) -> Self {
        let scale = DVec2::new(
            f64::from(width) / f64::from(self.width),
            f64::from(height) / f64::from(self.height),
        );
        Self {
            width,
            height,
            focal_px: self.focal_px * scale,
            principal_px: self.principal_px * scale,
            distortion: self.distortion,
        }
    }

    /// Centre of pixel number `at`, row by row.
    pub fn pixel_centre(&self, at: usize) -> DVec2 {
        let (x, y) = (at as u32 % self.width, at as u32 / self.width);
        DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5)
    }

    pub fn pixel_count(&self) -> usize {
        self.width as usize * self.height as usize
    }
}
