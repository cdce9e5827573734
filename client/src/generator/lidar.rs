//! The scanner: sweeps of ranges with noise, each point with its own time.

use glam::DVec3;
use rayon::prelude::*;

use backlot_engine::camera::Rigid;

use super::bvh::Ray;
use super::config::Error;
use super::noise::{gaussian, unit};
use super::render::ShadowCasters;
use super::shade::reflectance;
use super::world::StreetWorld;

/// Where the scanner sits in the ego frame.
const LIDAR_IN_EGO_M: DVec3 = DVec3::new(1.1, 0.0, 1.52);
/// Share of beams that glass swallows.
const LOST_ON_GLASS: f32 = 0.6;

/// One return of a sweep.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LidarPoint {
    /// LiDAR frame at the time of the point, metres.
    pub position_m: [f32; 3],
    /// 0..1.
    pub intensity: f32,
    /// Seconds after the sweep's timestamp at which the point was measured.
    pub time_s: f32,
}

impl LidarPoint {
    /// 20 bytes of the wire's XYZIT form.
    pub(super) fn to_bytes(self) -> impl Iterator<Item = u8> {
        let [x, y, z] = self.position_m;
        [x, y, z, self.intensity, self.time_s]
            .into_iter()
            .flat_map(f32::to_le_bytes)
    }
}

impl StreetWorld {
    /// Mounting of the scanner: upright, x forward.
    pub fn ego_from_lidar(&self) -> Rigid {
        Rigid::new(glam::DQuat::IDENTITY, LIDAR_IN_EGO_M)
    }

    /// The returns of one turn of the scanner that starts at the left end of its sector at `timestamp_ns`.
    ///
    /// Each column of beams sees the cars from the ego pose of its own time. `sweep` numbers the noise.
    ///
    /// # Errors
    /// Those of rendering.
    pub fn scan(&self, timestamp_ns: i64, sweep: u32) -> Result<Vec<LidarPoint>, Error> {
        let lidar = self.config.lidar;
        let columns = (2.0 * lidar.half_sector_rad / lidar.azimuth_step_rad).floor() as u32;
        let scanned: Vec<Vec<LidarPoint>> = (0..columns)
            .into_par_iter()
            .map(|column| self.scan_column(timestamp_ns, sweep, column))
            .collect::<Result<_, Error>>()?;
        Ok(scanned.concat())
    }

    fn scan_column(
        &self,
        timestamp_ns: i64,
        sweep: u32,
        column: u32,
    ) -> Result<Vec<LidarPoint>, Error> {
        let lidar = self.config.lidar;
        let turned = f64::from(column) * lidar.azimuth_step_rad;
        let time_s = turned / std::f64::consts::TAU * lidar.turn_s;
        let now_ns = timestamp_ns + (time_s * 1e9).round() as i64;
        let scene = self.scene(&self.actors_at(now_ns), &ShadowCasters::None)?;
        let world_from_lidar = self.world_from_ego(now_ns) * self.ego_from_lidar();
        let azimuth = lidar.half_sector_rad - turned;
        let rise =
            (lidar.elevation_max_rad - lidar.elevation_min_rad) / f64::from(lidar.beams.max(2) - 1);
        let mut points = Vec::with_capacity(lidar.beams as usize);
        for beam in 0..lidar.beams {
            let elevation = lidar.elevation_min_rad + rise * f64::from(beam);
            let (flat, up) = (libm::cos(elevation), libm::sin(elevation));
            let direction = DVec3::new(flat * libm::cos(azimuth), flat * libm::sin(azimuth), up);
            let ray = Ray {
                origin: world_from_lidar.translation_m.as_vec3(),
                direction: world_from_lidar.direction(direction).as_vec3(),
            };
            let Some(hit) = scene
                .nearest(&ray)
                .filter(|hit| f64::from(hit.t) < lidar.max_range_m)
            else {
                continue;
            };
            let index = column * lidar.beams + beam;
            let stream = self.seed() ^ sweep.wrapping_mul(0x9e37);
            let (intensity, glass) = reflectance(&scene, &ray, &hit, self.seed());
            if glass && unit(index, stream, 3) < LOST_ON_GLASS {
                continue;
            }
            let range_m = f64::from(hit.t) + lidar.range_noise_m * gaussian(index, stream, 1);
            points.push(LidarPoint {
                position_m: (direction * range_m).as_vec3().to_array(),
                intensity,
                time_s: time_s as f32,
            });
        }
        Ok(points)
    }
}
