//! Calibration folder of a KITTI raw recording day.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use backlot_engine::camera::{Camera, Distortion, Rigid};
use glam::{DQuat, DVec2, DVec3};

use super::error::{Error, Result};
use super::text;

/// The rectified left colour camera and its place on the car.
#[derive(Clone, Debug)]
pub(super) struct Calibration {
    /// Model of the rectified images of `image_02`.
    pub camera: Camera,
    /// Rectified camera 2 from rectified camera 0: a pure translation, from the fourth column of `P_rect_02`.
    pub camera2_from_camera0: Rigid,
    /// Rectified camera 0 from Velodyne: `R_rect_00` after `calib_velo_to_cam`.
    pub camera0_from_velodyne: Rigid,
    /// Where the sensor extrinsics of the IMU are; read only when oxts is used.
    imu_path: PathBuf,
}

impl Calibration {
    /// Reads `calib_cam_to_cam.txt` and `calib_velo_to_cam.txt`.
    ///
    /// # Errors
    /// Names the missing file, the missing key, or the line and field that do not parse.
    pub(super) fn read(folder: &Path) -> Result<Self> {
        let cameras = Entries::read(folder.join("calib_cam_to_cam.txt"))?;
        let [width, height] = cameras.numbers::<2>("S_rect_02")?;
        let p = cameras.numbers::<12>("P_rect_02")?;
        let camera = Camera {
            width: width as u32,
            height: height as u32,
            focal_px: DVec2::new(p[0], p[5]),
            principal_px: DVec2::new(p[2], p[6]),
            distortion: Distortion::None,
        };
        camera
            .validate("P_rect_02")
            .map_err(|e| Error::malformed(&cameras.path, e.to_string()))?;
        // P = K [I | t], so t = K^-1 p4. KITTI counts pixels from the centre of the first one, the
        // manifest from its corner: the half pixel belongs to the principal point and not to t.
        let t = DVec3::new(
            (p[3] - p[2] * p[11]) / p[0],
            (p[7] - p[6] * p[11]) / p[5],
            p[11],
        );
        let rectify = Rigid::new(cameras.rotation("R_rect_00")?, DVec3::ZERO);
        let velodyne = Entries::read(folder.join("calib_velo_to_cam.txt"))?;
        Ok(Self {
            camera: Camera {
                principal_px: camera.principal_px + 0.5,
                ..camera
            },
            camera2_from_camera0: Rigid::new(DQuat::IDENTITY, t),
            camera0_from_velodyne: rectify * velodyne.rigid()?,
            imu_path: folder.join("calib_imu_to_velo.txt"),
        })
    }

    pub(super) fn velodyne_from_camera2(&self) -> Rigid {
        (self.camera2_from_camera0 * self.camera0_from_velodyne).inverse()
    }

    /// Reads `calib_imu_to_velo.txt`.
    pub(super) fn velodyne_from_imu(&self) -> Result<Rigid> {
        Entries::read(self.imu_path.clone())?.rigid()
    }
}

/// A file of `key: numbers` lines.
struct Entries {
    path: PathBuf,
    /// Line number and text after the colon, by key.
    lines: BTreeMap<String, (usize, String)>,
}

impl Entries {
    fn read(path: PathBuf) -> Result<Self> {
        let hint = "the calibration folder must hold calib_cam_to_cam.txt, calib_velo_to_cam.txt and, \
                    for oxts, calib_imu_to_velo.txt (name it with --calib-dir)";
        let content = text::read(&path, hint)?;
        let lines = content
            .lines()
            .enumerate()
            .filter_map(|(i, line)| {
                let (key, values) = line.split_once(':')?;
                Some((key.trim().to_owned(), (i + 1, values.trim().to_owned())))
            })
            .collect();
        Ok(Self { path, lines })
    }

    fn line(&self, key: &str) -> Result<(usize, &str)> {
        let (line, values) = self
            .lines
            .get(key)
            .ok_or_else(|| Error::malformed(&self.path, format!("no line \"{key}:\"")))?;
        Ok((*line, values))
    }

    fn numbers<const N: usize>(&self, key: &str) -> Result<[f64; N]> {
        let (line, values) = self.line(key)?;
        text::numbers(&self.path, line, key, values)
    }

    fn rotation(&self, key: &str) -> Result<DQuat> {
        let rows = self.numbers::<9>(key)?;
        text::rotation(&self.path, self.line(key)?.0, key, &rows)
    }

    /// The `R:` and `T:` lines of an extrinsic file.
    fn rigid(&self) -> Result<Rigid> {
        let t = self.numbers::<3>("T")?;
        Ok(Rigid::new(self.rotation("R")?, DVec3::from_array(t)))
    }
}
