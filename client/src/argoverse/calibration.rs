//! Intrinsics and places of the sensors.

use std::collections::BTreeMap;
use std::path::Path;

use backlot_engine::camera::{Camera, Distortion, Rigid};
use glam::DVec2;

use super::feather::Columns;
use super::poses::{POSE_COLUMNS, rigids};
use crate::read_log::{Error, Result};

const HINT: &str = "an Argoverse 2 log holds calibration/intrinsics.feather and calibration/egovehicle_SE3_sensor.feather";

/// Calibration of a log, by sensor name.
#[derive(Debug)]
pub(super) struct Calibration {
    cameras: BTreeMap<String, Camera>,
    ego_from_sensor: BTreeMap<String, Rigid>,
    folder: std::path::PathBuf,
}

impl Calibration {
    pub(super) fn read(log_dir: &Path) -> Result<Self> {
        let folder = log_dir.join("calibration");
        Ok(Self {
            cameras: read_cameras(&folder.join("intrinsics.feather"))?,
            ego_from_sensor: read_places(&folder.join("egovehicle_SE3_sensor.feather"))?,
            folder,
        })
    }

    pub(super) fn camera(&self, name: &str) -> Result<&Camera> {
        self.cameras.get(name).ok_or_else(|| self.lacks(name))
    }

    pub(super) fn ego_from_sensor(&self, name: &str) -> Result<Rigid> {
        let place = self.ego_from_sensor.get(name);
        place.copied().ok_or_else(|| self.lacks(name))
    }

    pub(super) fn camera_names(&self) -> impl Iterator<Item = &str> {
        self.cameras.keys().map(String::as_str)
    }

    fn lacks(&self, name: &str) -> Error {
        Error::malformed(&self.folder, format!("has no calibration of {name}"))
    }
}

/// The images are undistorted, so k1 to k3 do not apply. Argoverse counts pixels from the centre of the first one, the
/// manifest from its corner.
fn read_cameras(path: &Path) -> Result<BTreeMap<String, Camera>> {
    let wanted = [
        "sensor_name",
        "fx_px",
        "fy_px",
        "cx_px",
        "cy_px",
        "width_px",
        "height_px",
    ];
    let columns = Columns::read(path, &wanted, HINT)?;
    let names = columns.texts("sensor_name")?;
    let [fx, fy] = [columns.numbers("fx_px")?, columns.numbers("fy_px")?];
    let [cx, cy] = [columns.numbers("cx_px")?, columns.numbers("cy_px")?];
    let [width, height] = [
        columns.integers("width_px")?,
        columns.integers("height_px")?,
    ];
    let mut cameras = BTreeMap::new();
    for (i, name) in names.into_iter().enumerate() {
        let pixels = |count: i64| u32::try_from(count).unwrap_or(0);
        let camera = Camera {
            width: pixels(width[i]),
            height: pixels(height[i]),
            focal_px: DVec2::new(fx[i], fy[i]),
            principal_px: DVec2::new(cx[i], cy[i]) + 0.5,
            distortion: Distortion::None,
        };
        camera.validate(&name).map_err(|e| columns.bad_row(i, e))?;
        cameras.insert(name, camera);
    }
    Ok(cameras)
}

fn read_places(path: &Path) -> Result<BTreeMap<String, Rigid>> {
    let wanted: Vec<&str> = POSE_COLUMNS.into_iter().chain(["sensor_name"]).collect();
    let columns = Columns::read(path, &wanted, HINT)?;
    let names = columns.texts("sensor_name")?;
    Ok(names.into_iter().zip(rigids(&columns)?).collect())
}
