//! Calibration: the folder of a KITTI raw recording day, or the file of a tracking sequence.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use backlot_engine::camera::{Camera, Distortion, Rigid};
use glam::{DQuat, DVec2, DVec3};

use super::text;
use crate::read_log::{Error, Result};

/// The rectified left colour camera and its place on the car.
#[derive(Clone, Debug)]
pub(super) struct Calibration {
    /// Model of the rectified images of `image_02`.
    pub camera: Camera,
    /// Rectified camera 2 from rectified camera 0: a pure translation, from the fourth column of `P_rect_02`.
    pub camera2_from_camera0: Rigid,
    /// Rectified camera 0 from Velodyne: `R_rect_00` after `calib_velo_to_cam`.
    pub camera0_from_velodyne: Rigid,
    imu: Imu,
}

/// The place of the IMU, which only oxts needs.
#[derive(Clone, Debug)]
enum Imu {
    /// A file that is read when it is needed.
    File(PathBuf),
    Known(Rigid),
}

impl Calibration {
    /// Reads `calib_cam_to_cam.txt` and `calib_velo_to_cam.txt`.
    ///
    /// # Errors
    /// Names the missing file, the missing key, or the line and field that do not parse.
    pub(super) fn read(folder: &Path) -> Result<Self> {
        let cameras = Entries::read(folder.join("calib_cam_to_cam.txt"))?;
        let [width, height] = cameras.numbers::<2>("S_rect_02")?;
        let (camera, camera2_from_camera0) =
            cameras.projection("P_rect_02", (width as u32, height as u32))?;
        let rectify = Rigid::new(cameras.rotation("R_rect_00")?, DVec3::ZERO);
        let velodyne = Entries::read(folder.join("calib_velo_to_cam.txt"))?;
        Ok(Self {
            camera,
            camera2_from_camera0,
            camera0_from_velodyne: rectify * velodyne.rigid()?,
            imu: Imu::File(folder.join("calib_imu_to_velo.txt")),
        })
    }

    /// Reads the file of a tracking sequence, whose images have `size` pixels.
    ///
    /// # Errors
    /// As for [`Self::read`].
    pub(super) fn read_tracking(path: &Path, size: (u32, u32)) -> Result<Self> {
        let entries = Entries::read(path.to_owned())?;
        let (camera, camera2_from_camera0) = entries.projection("P2", size)?;
        let rectify = Rigid::new(entries.rotation("R_rect")?, DVec3::ZERO);
        Ok(Self {
            camera,
            camera2_from_camera0,
            camera0_from_velodyne: rectify * entries.rigid_of("Tr_velo_cam")?,
            imu: Imu::Known(entries.rigid_of("Tr_imu_velo")?),
        })
    }

    pub(super) fn velodyne_from_camera2(&self) -> Rigid {
        (self.camera2_from_camera0 * self.camera0_from_velodyne).inverse()
    }

    pub(super) fn velodyne_from_imu(&self) -> Result<Rigid> {
        match &self.imu {
            Imu::File(path) => Entries::read(path.clone())?.rigid(),
            Imu::Known(velodyne_from_imu) => Ok(*velodyne_from_imu),
        }
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
        let hint = "a raw drive needs a calibration folder with calib_cam_to_cam.txt, calib_velo_to_cam.txt and, for oxts, \
                    calib_imu_to_velo.txt (name it with --calib-dir); a tracking sequence needs calib/<sequence>.txt";
        let content = text::read(&path, hint)?;
        let lines = content
            .lines()
            .enumerate()
            .filter_map(|(i, line)| {
                // Some keys of the tracking benchmark have no colon.
                let (key, values) = line.split_once(':').or_else(|| line.split_once(' '))?;
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

    /// A camera of `size` pixels and its offset from camera 0, from a 3x4 projection matrix.
    fn projection(&self, key: &str, size: (u32, u32)) -> Result<(Camera, Rigid)> {
        let p = self.numbers::<12>(key)?;
        let camera = Camera {
            width: size.0,
            height: size.1,
            focal_px: DVec2::new(p[0], p[5]),
            // KITTI counts pixels from the centre of the first one, the manifest from its corner: the half pixel
            // belongs to the principal point and not to the offset.
            principal_px: DVec2::new(p[2], p[6]) + 0.5,
            distortion: Distortion::None,
        };
        camera
            .validate(key)
            .map_err(|e| Error::malformed(&self.path, e.to_string()))?;
        // P = K [I | t], so t = K^-1 p4.
        let t = DVec3::new(
            (p[3] - p[2] * p[11]) / p[0],
            (p[7] - p[6] * p[11]) / p[5],
            p[11],
        );
        Ok((camera, Rigid::new(DQuat::IDENTITY, t)))
    }

    /// A 3x4 matrix.
    fn rigid_of(&self, key: &str) -> Result<Rigid> {
        let m = self.numbers::<12>(key)?;
        let rows = [m[0], m[1], m[2], m[4], m[5], m[6], m[8], m[9], m[10]];
        let rotation = text::rotation(&self.path, self.line(key)?.0, key, &rows)?;
        Ok(Rigid::new(rotation, DVec3::new(m[3], m[7], m[11])))
    }

    /// The `R:` and `T:` lines of an extrinsic file.
    fn rigid(&self) -> Result<Rigid> {
        let t = self.numbers::<3>("T")?;
        Ok(Rigid::new(self.rotation("R")?, DVec3::from_array(t)))
    }
}
