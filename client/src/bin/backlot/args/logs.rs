//! Arguments of `backlot logs`, and what says which log is meant.

use std::path::PathBuf;

use clap::{Args, Subcommand, ValueEnum};

#[derive(Debug, Subcommand)]
pub(crate) enum LogsCommand {
    /// Read a log and upload what the server lacks of it; run again after a cut to send the rest.
    Upload(UploadOptions),
    /// Read a log and tell what was understood, with pictures of LiDAR and cuboids over the images; needs no server.
    Inspect(InspectOptions),
    /// List the logs on the server.
    List,
    /// Show one log.
    Show {
        log: String,
        /// Show what the newest decomposition made of each track: frames kept, frames rejected, and why.
        #[arg(long)]
        tracks: bool,
    },
    /// Remove a log.
    Delete { log: String },
}

#[derive(Debug, Args)]
pub(crate) struct UploadOptions {
    /// Folder of the log, e.g. .../2011_09_26_drive_0052_sync; not needed for the format `generated`.
    #[arg(value_name = "PATH", required_unless_present("format"))]
    pub path: Option<PathBuf>,
    /// By default what the folder looks like.
    #[arg(long, value_enum)]
    pub format: Option<LogFormat>,
    #[command(flatten)]
    pub parts: LogParts,
    /// Name on the server.
    #[arg(long)]
    pub name: String,
    /// Seed of a generated log.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    #[command(flatten)]
    pub street: StreetOptions,
}

#[derive(Debug, Args)]
pub(crate) struct InspectOptions {
    /// Folder of the log.
    #[arg(value_name = "PATH", required_unless_present("format"))]
    pub path: Option<PathBuf>,
    /// By default what the folder looks like.
    #[arg(long, value_enum)]
    pub format: Option<LogFormat>,
    #[command(flatten)]
    pub parts: LogParts,
    /// Folder of the pictures and of report.json.
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Pictures of each camera, evenly spaced over the log.
    #[arg(long, value_name = "N", default_value_t = 3)]
    pub pictures: usize,
    /// Draw, too, what a decomposition learns from in those frames (CAMERA_FRAME_masks.png): objects in colour and what may be them in
    /// dots, the reason for tracks that are not used, and hatched what teaches the background nothing.
    #[arg(long)]
    pub masks: bool,
    /// Seed of a generated log.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    #[command(flatten)]
    pub street: StreetOptions,
}

/// How much of a generated street is recorded; by default what the demo records.
#[derive(Clone, Copy, Debug, Default, Args)]
pub(crate) struct StreetOptions {
    /// Images of a generated log.
    #[arg(long, value_name = "N")]
    pub frames: Option<u32>,
    /// Size of the images of a generated log.
    #[arg(long, value_name = "PIXELS")]
    pub width: Option<u32>,
    #[arg(long, value_name = "PIXELS")]
    pub height: Option<u32>,
    /// Path of the ego vehicle in a generated log.
    #[arg(long, value_name = "METRES")]
    pub travel_m: Option<f64>,
    /// What a generated log says about depth.
    #[arg(long, value_enum, value_name = "SOURCE")]
    pub depth: Option<Depth>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum Depth {
    /// Sweeps of a scanner; the default.
    Lidar,
    /// A monocular depth map for every image.
    Maps,
    /// Points of structure from motion.
    Points,
    None,
}

/// Which log of a data set, and the parts of a KITTI raw log that lie elsewhere.
#[derive(Clone, Debug, Default, Args)]
pub(crate) struct LogParts {
    /// nuScenes scene, Waymo segment, Argoverse log or KITTI tracking sequence, where PATH holds several.
    #[arg(long, value_name = "NAME")]
    pub scene: Option<String>,
    /// Folder of calib_cam_to_cam.txt and calib_velo_to_cam.txt; by default the one above PATH.
    #[arg(long, value_name = "DIR")]
    pub calib_dir: Option<PathBuf>,
    /// Camera poses in KITTI odometry format; by default the oxts packets of the drive.
    #[arg(long, value_name = "FILE")]
    pub poses: Option<PathBuf>,
    /// tracklet_labels.xml or a KITTI tracking label file; by default the drive's tracklet_labels.xml.
    #[arg(long, value_name = "FILE")]
    pub tracks: Option<PathBuf>,
    /// Depth maps to read beside the log: DIR/CAMERA/FRAME.png, 16-bit grey, 0 is unknown, as KITTI's depth data.
    #[arg(long, value_name = "DIR")]
    pub depth_maps: Option<PathBuf>,
    /// Metres along the optical axis in one unit of those maps [default: 1/256, as KITTI's].
    #[arg(long, value_name = "METRES", requires = "depth_maps")]
    pub depth_unit_m: Option<f64>,
    /// How those maps were made, which decides how much they weigh.
    #[arg(long, value_enum, default_value_t = DepthKind::Stereo, requires = "depth_maps")]
    pub depth_kind: DepthKind,
    /// Points of structure from motion in the log's world frame: points3D.txt of COLMAP, with images.txt beside it (images named
    /// CAMERA/FRAME.png) for which image saw which point; or .ply; or .csv of x,y,z.
    #[arg(long, value_name = "FILE")]
    pub sfm_points: Option<PathBuf>,
    /// Metres in one unit of those points.
    #[arg(
        long,
        value_name = "METRES",
        default_value_t = 1.0,
        requires = "sfm_points"
    )]
    pub sfm_unit_m: f64,
    /// Leave the log's LiDAR out.
    #[arg(long)]
    pub no_lidar: bool,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub(crate) enum DepthKind {
    /// Triangulated between cameras of known baseline.
    #[default]
    Stereo,
    /// Guessed from one image and brought to metres.
    Monocular,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum LogFormat {
    /// Drive folder of the KITTI raw data set.
    KittiRaw,
    /// Folder of a split of the KITTI tracking benchmark: image_02, velodyne, calib, oxts, label_02.
    KittiTracking,
    /// nuScenes folder: v1.0-*, samples, sweeps.
    Nuscenes,
    /// Argoverse 2 sensor log, or a split of them.
    Av2,
    /// Folder of the components of Waymo Open v2: camera_image, vehicle_pose, lidar, ...
    Waymo,
    /// No files: a synthetic, ray-traced street.
    Generated,
}
