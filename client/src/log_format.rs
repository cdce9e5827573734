//! The data sets that can be read, and how to tell which one a folder is.

use std::fmt;
use std::path::{Path, PathBuf};

use crate::argoverse::{ArgoverseInputs, is_argoverse, read_argoverse};
use crate::kitti::{
    KittiInputs, KittiTrackingInputs, is_kitti_raw, is_kitti_tracking, read_kitti_raw,
    read_kitti_tracking,
};
use crate::nuscenes::{NuscenesInputs, is_nuscenes, read_nuscenes};
use crate::read_log::{Error, ReadLog, Result};
use crate::waymo::{WaymoInputs, is_waymo, read_waymo};

/// A data set's form on disk.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LogFormat {
    KittiRaw,
    KittiTracking,
    Nuscenes,
    Argoverse2,
    Waymo,
}

/// What a reader needs to know.
#[derive(Clone, Debug, Default)]
pub struct LogInputs {
    pub path: PathBuf,
    /// Scene, segment, sequence or log, where the path holds several.
    pub scene: Option<String>,
    /// Only for KITTI raw: see [`KittiInputs`].
    pub calib_dir: Option<PathBuf>,
    pub poses: Option<PathBuf>,
    pub tracks: Option<PathBuf>,
}

impl LogFormat {
    pub const ALL: [Self; 5] = [
        Self::KittiRaw,
        Self::KittiTracking,
        Self::Nuscenes,
        Self::Argoverse2,
        Self::Waymo,
    ];

    /// The format of a folder, by the files it holds.
    ///
    /// # Errors
    /// The path is missing or of no known layout; the message says what each looks like.
    pub fn detect(path: &Path) -> Result<Self> {
        if !path.exists() {
            let source = std::io::ErrorKind::NotFound.into();
            return Err(Error::io(path, source, "PATH must be the folder of a log"));
        }
        let format = Self::ALL.into_iter().find(|format| format.is_at(path));
        format.ok_or_else(|| {
            let layouts: Vec<String> = Self::ALL
                .iter()
                .map(|f| format!("{f} ({})", f.layout()))
                .collect();
            let what = format!(
                "is a log of no known layout. Known are {}",
                layouts.join(", ")
            );
            Error::malformed(path, what)
        })
    }

    /// Reads a log.
    ///
    /// # Errors
    /// Those of the format's reader; and parts given that only KITTI raw has.
    pub fn read(self, inputs: &LogInputs) -> Result<ReadLog> {
        let path = inputs.path.clone();
        let scene = inputs.scene.clone();
        let foreign =
            inputs.calib_dir.is_some() || inputs.poses.is_some() || inputs.tracks.is_some();
        if foreign && self != Self::KittiRaw {
            let what = format!(
                "calibration, pose and track files apart from the log are for kitti-raw, not for {self}"
            );
            return Err(Error::choice(&path, what));
        }
        match self {
            Self::KittiRaw => read_kitti_raw(&KittiInputs {
                drive_dir: path,
                calib_dir: inputs.calib_dir.clone(),
                poses: inputs.poses.clone(),
                tracks: inputs.tracks.clone(),
            }),
            Self::KittiTracking => read_kitti_tracking(&KittiTrackingInputs {
                root: path,
                sequence: scene,
            }),
            Self::Nuscenes => read_nuscenes(&NuscenesInputs {
                data_root: path,
                scene,
            }),
            Self::Argoverse2 => read_argoverse(&ArgoverseInputs { path, log: scene }),
            Self::Waymo => read_waymo(&WaymoInputs {
                root: path,
                segment: scene,
            }),
        }
    }

    fn is_at(self, path: &Path) -> bool {
        match self {
            Self::KittiRaw => is_kitti_raw(path),
            Self::KittiTracking => is_kitti_tracking(path),
            Self::Nuscenes => is_nuscenes(path),
            Self::Argoverse2 => is_argoverse(path),
            Self::Waymo => is_waymo(path),
        }
    }

    /// What its folder holds.
    fn layout(self) -> &'static str {
        match self {
            Self::KittiRaw => "image_02/data",
            Self::KittiTracking => "image_02/0001, calib",
            Self::Nuscenes => "v1.0-*, samples",
            Self::Argoverse2 => "city_SE3_egovehicle.feather, sensors",
            Self::Waymo => "camera_image, vehicle_pose",
        }
    }
}

impl fmt::Display for LogFormat {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::KittiRaw => "kitti-raw",
            Self::KittiTracking => "kitti-tracking",
            Self::Nuscenes => "nuscenes",
            Self::Argoverse2 => "av2",
            Self::Waymo => "waymo",
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn layouts_are_told_apart() {
        let folder = tempfile::TempDir::new().unwrap();
        for (format, file) in [
            (LogFormat::KittiRaw, "image_02/data/0.png"),
            (LogFormat::KittiTracking, "image_02/0001/0.png"),
            (LogFormat::Nuscenes, "v1.0-mini/sample_data.json"),
            (LogFormat::Argoverse2, "log/city_SE3_egovehicle.feather"),
            (LogFormat::Waymo, "camera_image/a.parquet"),
        ] {
            let root = folder.path().join(format.to_string());
            for file in [file, "calib/0001.txt", "vehicle_pose/a.parquet"] {
                let path = root.join(file);
                std::fs::create_dir_all(path.parent().unwrap()).unwrap();
                std::fs::write(path, "").unwrap();
            }
            assert_eq!(LogFormat::detect(&root).unwrap(), format);
        }
    }

    #[test]
    fn an_unknown_layout_is_one_line_that_lists_the_known_ones() {
        let folder = tempfile::TempDir::new().unwrap();
        let error = LogFormat::detect(folder.path()).unwrap_err().to_string();
        for text in [
            "no known layout",
            "image_02/data",
            "v1.0-*",
            "city_SE3_egovehicle",
            "vehicle_pose",
        ] {
            assert!(error.contains(text), "{error}");
        }
        assert_eq!(error.lines().count(), 1);
        let error = LogFormat::detect(&folder.path().join("none"))
            .unwrap_err()
            .to_string();
        assert!(error.contains("none: not found"), "{error}");
    }

    #[test]
    fn parts_of_kitti_raw_are_refused_elsewhere() {
        let inputs = LogInputs {
            poses: Some("poses.txt".into()),
            ..LogInputs::default()
        };
        let error = LogFormat::Waymo.read(&inputs).unwrap_err().to_string();
        assert!(error.contains("for kitti-raw, not for waymo"), "{error}");
    }
}
