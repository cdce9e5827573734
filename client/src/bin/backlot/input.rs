//! Reading a log in the format the caller names, or that its folder shows.

use std::path::Path;

use anyhow::Context;
use backlot_client::depth_maps::{DepthMapInputs, KITTI_UNIT_M, add_depth_maps};
use backlot_client::generator::{DepthRecording, StreetConfig, StreetWorld};
use backlot_client::log_format::{self, LogInputs};
use backlot_client::read_log::ReadLog;
use backlot_client::sfm_points::{SfmPointInputs, add_sfm_points};
use backlot_proto::v1;

use crate::args::{Depth, DepthKind, LogFormat, LogParts, StreetOptions};

/// Where a log comes from.
pub(crate) struct LogSource<'a> {
    pub path: Option<&'a Path>,
    pub format: Option<LogFormat>,
    pub parts: &'a LogParts,
    pub seed: u64,
    pub street: &'a StreetOptions,
}

/// Reads or generates a log and tells what the reader ignored or assumed.
pub(crate) fn read(source: &LogSource<'_>) -> anyhow::Result<ReadLog> {
    if source.format == Some(LogFormat::Generated) {
        return generate(source.seed, source.street);
    }
    let path = source.path.context("PATH is missing")?;
    read_folder(path, source.format, source.parts)
}

/// Reads the log in a folder and tells what the reader ignored or assumed.
pub(crate) fn read_folder(
    path: &Path,
    format: Option<LogFormat>,
    parts: &LogParts,
) -> anyhow::Result<ReadLog> {
    let format = match format.and_then(LogFormat::on_disk) {
        Some(format) => format,
        None => log_format::LogFormat::detect(path)?,
    };
    let mut log = format.read(&LogInputs {
        path: path.to_owned(),
        scene: parts.scene.clone(),
        calib_dir: parts.calib_dir.clone(),
        poses: parts.poses.clone(),
        tracks: parts.tracks.clone(),
    })?;
    if parts.no_lidar {
        log.leave_lidar_out();
    }
    if let Some(folder) = &parts.depth_maps {
        let inputs = DepthMapInputs {
            folder: folder.clone(),
            unit_m: parts.depth_unit_m.unwrap_or(KITTI_UNIT_M),
            kind: match parts.depth_kind {
                DepthKind::Stereo => v1::DepthMapKind::Stereo,
                DepthKind::Monocular => v1::DepthMapKind::Monocular,
            },
        };
        add_depth_maps(&mut log, &inputs)?;
    }
    if let Some(file) = &parts.sfm_points {
        let inputs = SfmPointInputs {
            file: file.clone(),
            unit_m: parts.sfm_unit_m,
        };
        add_sfm_points(&mut log, &inputs)?;
    }
    for note in &log.drive_log.notes {
        eprintln!("note: {note}");
    }
    Ok(log)
}

impl LogFormat {
    /// The data set of that form; `None` for a generated log.
    fn on_disk(self) -> Option<log_format::LogFormat> {
        Some(match self {
            Self::KittiRaw => log_format::LogFormat::KittiRaw,
            Self::KittiTracking => log_format::LogFormat::KittiTracking,
            Self::Nuscenes => log_format::LogFormat::Nuscenes,
            Self::Av2 => log_format::LogFormat::Argoverse2,
            Self::Waymo => log_format::LogFormat::Waymo,
            Self::Generated => return None,
        })
    }
}

impl Depth {
    fn recording(self) -> DepthRecording {
        match self {
            Self::Lidar => DepthRecording::Lidar,
            Self::Maps => DepthRecording::Maps,
            Self::Points => DepthRecording::Points,
            Self::None => DepthRecording::None,
        }
    }
}

/// The demo's street with another seed, and as much of it as asked for.
fn generate(seed: u64, street: &StreetOptions) -> anyhow::Result<ReadLog> {
    let demo = StreetConfig::default();
    let travel_m = street.travel_m.unwrap_or(demo.travel_m);
    let config = StreetConfig {
        seed,
        parked_cars: StreetConfig::parked_along(travel_m),
        frames: street.frames.unwrap_or(demo.frames),
        width: street.width.unwrap_or(demo.width),
        height: street.height.unwrap_or(demo.height),
        travel_m,
        depth: street.depth.map_or(demo.depth, Depth::recording),
        ..demo
    };
    eprintln!("note: a generated log is synthetic: its images are ray-traced");
    Ok(StreetWorld::new(&config)?.read_log()?)
}
