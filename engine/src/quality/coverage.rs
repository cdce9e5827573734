//! From where an object was seen.

use glam::DVec3;
use serde::{Deserialize, Serialize};

use crate::camera::Rigid;

/// Sectors of 15 degrees around the object.
pub const AZIMUTH_SECTORS: usize = 24;

/// The directions and distances from which an object's training views saw it, in the object's frame.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ViewCoverage {
    /// Training views per sector of the camera's azimuth; sector 0 starts at +x (the front), turning left (towards +y).
    pub azimuth_views: [u32; AZIMUTH_SECTORS],
    /// Sectors seen only through the mirror symmetry.
    pub azimuth_mirrored: [bool; AZIMUTH_SECTORS],
    /// Azimuth of every training camera, and of its mirror image for a symmetric object; radians in (-pi, pi], ascending.
    pub azimuths_rad: Vec<f64>,
    pub elevation_min_rad: f64,
    pub elevation_max_rad: f64,
    pub distance_min_m: f64,
    pub distance_max_m: f64,
}

impl ViewCoverage {
    /// Coverage by cameras at the given poses (object from camera); `symmetric` adds the mirrored sectors.
    pub fn of_cameras(object_from_camera: &[Rigid], symmetric: bool) -> Self {
        let mut coverage = Self::default();
        for (number, pose) in object_from_camera.iter().enumerate() {
            coverage.add(pose.translation_m, number == 0);
        }
        let azimuths = object_from_camera.iter().map(azimuth_of);
        coverage.azimuths_rad = azimuths.collect();
        if symmetric {
            let mirrored: Vec<f64> = coverage.azimuths_rad.iter().map(|a| -a).collect();
            coverage.azimuths_rad.extend(mirrored);
            for sector in 0..AZIMUTH_SECTORS {
                // Mirroring y turns azimuth a into -a, that is sector s into 23 - s.
                let seen = coverage.azimuth_views[AZIMUTH_SECTORS - 1 - sector] > 0;
                coverage.azimuth_mirrored[sector] = seen && coverage.azimuth_views[sector] == 0;
            }
        }
        coverage.azimuths_rad.sort_by(f64::total_cmp);
        coverage
    }

    /// Whether the sector of this azimuth was seen, directly or through the mirror symmetry.
    pub fn sees(&self, azimuth_rad: f64) -> bool {
        let sector = sector_of(azimuth_rad);
        self.azimuth_views[sector] > 0 || self.azimuth_mirrored[sector]
    }

    fn add(&mut self, camera_m: DVec3, first: bool) {
        let distance = camera_m.length();
        let elevation = libm::atan2(camera_m.z, camera_m.truncate().length());
        self.azimuth_views[sector_of(libm::atan2(camera_m.y, camera_m.x))] += 1;
        if first {
            (self.elevation_min_rad, self.elevation_max_rad) = (elevation, elevation);
            (self.distance_min_m, self.distance_max_m) = (distance, distance);
        }
        self.elevation_min_rad = self.elevation_min_rad.min(elevation);
        self.elevation_max_rad = self.elevation_max_rad.max(elevation);
        self.distance_min_m = self.distance_min_m.min(distance);
        self.distance_max_m = self.distance_max_m.max(distance);
    }
}

fn azimuth_of(object_from_camera: &Rigid) -> f64 {
    let eye = object_from_camera.translation_m;
    libm::atan2(eye.y, eye.x)
}

fn sector_of(azimuth_rad: f64) -> usize {
    let turn = azimuth_rad.rem_euclid(std::f64::consts::TAU) / std::f64::consts::TAU;
    ((turn * AZIMUTH_SECTORS as f64) as usize).min(AZIMUTH_SECTORS - 1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DQuat;

    fn camera_at(degrees: f64, distance_m: f64) -> Rigid {
        let (sin, cos) = degrees.to_radians().sin_cos();
        let position = DVec3::new(cos * distance_m, sin * distance_m, 1.0);
        Rigid::new(DQuat::IDENTITY, position)
    }

    #[test]
    fn symmetry_adds_the_mirrored_sectors_only() {
        let cameras = [camera_at(20.0, 10.0), camera_at(100.0, 20.0)];
        let plain = ViewCoverage::of_cameras(&cameras, false);
        let mirrored = ViewCoverage::of_cameras(&cameras, true);
        assert!(plain.sees(20f64.to_radians()) && !plain.sees(-20f64.to_radians()));
        assert!(mirrored.sees(-20f64.to_radians()) && mirrored.sees(-100f64.to_radians()));
        assert!(!mirrored.sees(60f64.to_radians()));
        assert!(!mirrored.azimuth_mirrored[1]);
        assert!((plain.distance_min_m - 101f64.sqrt()).abs() < 1e-9);
        assert!(plain.elevation_min_rad < plain.elevation_max_rad);
    }
}
