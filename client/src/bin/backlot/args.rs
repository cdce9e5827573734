//! The arguments: the contract with people and scripts.

use std::path::PathBuf;

use backlot_engine::backend::DeviceChoice;
use clap::{Args, Parser, Subcommand, ValueEnum};

use crate::recipe::RecipeOptions;

/// Turn driving logs into labelled, augmented images.
#[derive(Debug, Parser)]
#[command(name = "backlot", version, propagate_version = true)]
pub(crate) struct Arguments {
    /// Address of the server.
    #[arg(
        long,
        global = true,
        env = "BACKLOT_SERVER",
        value_name = "URL",
        default_value = "http://127.0.0.1:50051"
    )]
    pub server: String,

    /// Form of results on standard output.
    #[arg(long, global = true, value_enum, default_value_t = Output::Table)]
    pub output: Output,

    #[command(subcommand)]
    pub command: Command,
}

#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    /// Driving logs on the server.
    #[command(subcommand)]
    Logs(LogsCommand),
    /// Training jobs.
    #[command(subcommand)]
    Jobs(JobsCommand),
    /// Trained backgrounds and objects.
    #[command(subcommand)]
    Assets(AssetsCommand),
    /// Render labelled samples from a background and the library's objects.
    Augment(Box<AugmentOptions>),
    /// List what this machine can compute on: GPUs with their limits, and the processor.
    Devices,
    /// Run everything once with an embedded server: a log goes in, labelled samples come out.
    Demo(DemoOptions),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum Output {
    Table,
    /// An array of objects.
    Json,
}

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

#[derive(Debug, Subcommand)]
pub(crate) enum JobsCommand {
    /// Queue training of a log's background or of its objects, or its decomposition alone.
    Submit(SubmitOptions),
    /// List jobs.
    List {
        /// Only jobs of this log.
        #[arg(long)]
        log: Option<String>,
    },
    /// Follow a job; fails if the job does.
    Watch { job: String },
    /// Ask a job to stop.
    Cancel { job: String },
}

#[derive(Debug, Args)]
pub(crate) struct SubmitOptions {
    #[arg(value_enum)]
    pub kind: JobKind,
    #[arg(long)]
    pub log: String,
    #[arg(long, value_enum, default_value_t = Budget::Standard)]
    pub budget: Budget,
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
    /// Hold every n-th frame out of training for the quality report.
    #[arg(long, value_name = "N")]
    pub hold_out_every: Option<u32>,
    /// Repeating a submission with the same id returns the same job.
    #[arg(long)]
    pub request_id: Option<String>,
    /// Follow the job to its end; fails if the job does.
    #[arg(long)]
    pub watch: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum JobKind {
    Background,
    Objects,
    /// Masks and training sets alone, kept for later jobs on the log.
    Decompose,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum Budget {
    Quick,
    Standard,
    /// The constants of the paper.
    Paper,
}

#[derive(Debug, Subcommand)]
pub(crate) enum AssetsCommand {
    /// List assets.
    List {
        /// Only assets of this kind.
        #[arg(long, value_enum)]
        kind: Option<AssetKind>,
        /// Only assets of this log.
        #[arg(long)]
        log: Option<String>,
    },
    /// Show one asset.
    Show { asset: String },
    /// Write an asset's payload to a file.
    Export {
        asset: String,
        #[arg(long, value_name = "FILE")]
        out: PathBuf,
    },
    /// Draw where objects may stand on a background, seen from above, with placements that a recipe would make.
    ValidRegion(Box<ValidRegionOptions>),
    /// Remove an asset from the library.
    Delete { asset: String },
}

#[derive(Debug, Args)]
pub(crate) struct ValidRegionOptions {
    /// A background.
    pub asset: String,
    /// The map, a PNG.
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
    /// Samples whose placements are drawn.
    #[arg(long, value_name = "N", default_value_t = 100)]
    pub samples: u64,
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
    #[command(flatten)]
    pub recipe: RecipeOptions,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum AssetKind {
    Background,
    Object,
}

#[derive(Debug, Args)]
pub(crate) struct AugmentOptions {
    #[arg(long)]
    pub background: String,
    /// Folder of the samples.
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    #[arg(long, default_value_t = 12)]
    pub count: u64,
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
    /// First sample of the recipe's sequence: continues an interrupted run.
    #[arg(long, default_value_t = 0, value_name = "INDEX")]
    pub start: u64,
    #[command(flatten)]
    pub recipe: RecipeOptions,
    /// Forms of the labels, several separated by commas.
    #[arg(
        long,
        visible_alias = "label-format",
        value_enum,
        value_delimiter = ',',
        default_value = "kitti"
    )]
    pub labels: Vec<LabelFormat>,
    #[command(flatten)]
    pub actors: ActorOptions,
    #[command(flatten)]
    pub clip: ClipOptions,
    /// Recorded frames to draw from, by their index in the log; by default all.
    #[arg(long, value_delimiter = ',', value_name = "INDEX")]
    pub frame_indices: Vec<u32>,
    /// Do not cast shadows from inserted objects.
    #[arg(long)]
    pub no_shadows: bool,
    /// Keep the light that objects of other logs were recorded in.
    #[arg(long)]
    pub keep_tones: bool,
    /// Keep the sunlight that inserted objects were recorded in instead of that of their place.
    #[arg(long)]
    pub keep_light: bool,
    /// Direction towards the sun in the log's world frame; by default the log's, or as its shadows tell.
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    pub sun: Option<String>,
    /// Size of the longer side of the images; by default as recorded.
    #[arg(long, value_name = "PIXELS", default_value_t = 0)]
    pub longer_side: u32,
    /// Write no depth images.
    #[arg(long)]
    pub no_depth: bool,
    /// Write no instance images.
    #[arg(long)]
    pub no_instance: bool,
}

/// Changes to the log's moving objects, and objects at given places.
#[derive(Clone, Debug, Default, Args)]
pub(crate) struct ActorOptions {
    /// Track of an original moving object to leave out.
    #[arg(long, value_delimiter = ',', value_name = "TRACK")]
    pub remove: Vec<String>,
    /// Original moving object to show beside its path: metres forward and left of it, and degrees turned left.
    #[arg(long = "move", value_parser = parse_shift, value_name = "TRACK:X,Y[,DEGREES]")]
    pub shift: Vec<ShiftedTrack>,
    /// Object that stands or drives where it is said, in the log's world: an asset, or `track:TRACK` for an original moving object. Each
    /// waypoint is seconds after the first frame, x, y in metres and heading in degrees.
    #[arg(long, value_parser = parse_path, value_name = "OBJECT:S,X,Y,DEGREES[;...]")]
    pub path: Vec<GivenPath>,
}

#[derive(Clone, Debug, PartialEq)]
pub(crate) struct ShiftedTrack {
    pub track: String,
    pub forward_m: f64,
    pub left_m: f64,
    pub turn_deg: f64,
}

#[derive(Clone, Debug, PartialEq)]
pub(crate) struct GivenPath {
    pub object: GivenObjectName,
    /// Seconds, x, y, degrees.
    pub waypoints: Vec<[f64; 4]>,
}

#[derive(Clone, Debug, PartialEq)]
pub(crate) enum GivenObjectName {
    Track(String),
    Asset(String),
}

/// Samples of several frames.
#[derive(Clone, Debug, Args)]
pub(crate) struct ClipOptions {
    /// Frames a sample; more than one makes clips.
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub clip_frames: u32,
    /// Recorded frames from one frame of a clip to the next.
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub clip_stride: u32,
    /// Speed of inserted objects in m/s, or a range to draw from.
    #[arg(long, value_parser = parse_range, value_name = "LOW[..HIGH]", default_value = "0")]
    pub speed: [f64; 2],
}

fn parse_shift(text: &str) -> Result<ShiftedTrack, String> {
    let (track, numbers) = text
        .rsplit_once(':')
        .ok_or("expected TRACK:X,Y[,DEGREES]")?;
    let (forward_m, left_m, turn_deg) = match parse_numbers(numbers)?[..] {
        [x, y] => (x, y, 0.0),
        [x, y, turn] => (x, y, turn),
        _ => return Err("expected X,Y or X,Y,DEGREES after the track".to_owned()),
    };
    Ok(ShiftedTrack {
        track: track.to_owned(),
        forward_m,
        left_m,
        turn_deg,
    })
}

fn parse_path(text: &str) -> Result<GivenPath, String> {
    let (object, points) = text
        .rsplit_once(':')
        .ok_or("expected OBJECT:S,X,Y,DEGREES[;...]")?;
    let object = match object.strip_prefix("track:") {
        Some(track) => GivenObjectName::Track(track.to_owned()),
        None => GivenObjectName::Asset(object.to_owned()),
    };
    let waypoints = points.split(';').map(|point| {
        let numbers = parse_numbers(point)?;
        let count = numbers.len();
        <[f64; 4]>::try_from(numbers)
            .map_err(|_| format!("waypoint \"{point}\" has {count} numbers, not S,X,Y,DEGREES"))
    });
    Ok(GivenPath {
        object,
        waypoints: waypoints.collect::<Result<_, _>>()?,
    })
}

fn parse_range(text: &str) -> Result<[f64; 2], String> {
    let (low, high) = text.split_once("..").unwrap_or((text, text));
    Ok([parse_number(low)?, parse_number(high)?])
}

fn parse_numbers(text: &str) -> Result<Vec<f64>, String> {
    text.split(',').map(parse_number).collect()
}

fn parse_number(text: &str) -> Result<f64, String> {
    let number = text.trim().parse::<f64>().ok().filter(|n| n.is_finite());
    number.ok_or_else(|| format!("\"{text}\" is not a number"))
}

#[derive(Debug, Args)]
pub(crate) struct DemoOptions {
    /// Folder of the results and of the server's store.
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Folder of a recorded log; without it a synthetic street is generated.
    #[arg(long, value_name = "PATH", requires = "format")]
    pub log: Option<PathBuf>,
    /// Format of the log.
    #[arg(long, value_enum)]
    pub format: Option<LogFormat>,
    #[command(flatten)]
    pub parts: LogParts,
    /// Time for quality; by default `quick` for the generated street and `standard` for a recorded log.
    #[arg(long, value_enum)]
    pub budget: Option<Budget>,
    /// Seed of the generated log, of training and of the samples.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// What renders: auto, cpu, gpu, gpu:NUMBER or gpu:NAME as `backlot devices` lists them.
    #[arg(long, value_name = "DEVICE", default_value = "auto")]
    pub device: DeviceChoice,
    /// Direction towards the sun in the log's world frame; by default the log's, or as its shadows tell.
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    pub sun: Option<String>,
    /// Samples to render; the paper makes 12 of each background.
    #[arg(long, default_value_t = 12)]
    pub count: u64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum LabelFormat {
    /// Label and calibration files as of KITTI objects; clips also as of KITTI tracking.
    Kitti,
    /// Everything a sample says, a file an image.
    Json,
    /// coco.json with boxes and masks.
    Coco,
    /// Tables of the nuScenes schema in v1.0-backlot/.
    Nuscenes,
    /// Parquet components of the Waymo Open Dataset 2 schema in waymo/.
    Waymo,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shifts_paths_and_ranges_are_read_and_wrong_ones_named() {
        let shift = parse_shift("car:7:2,-1.5,90").unwrap();
        assert_eq!((shift.track.as_str(), shift.turn_deg), ("car:7", 90.0));
        assert!(parse_shift("7:2").unwrap_err().contains("X,Y"));
        assert!(parse_shift("7:2,x").unwrap_err().contains("\"x\""));
        let path = parse_path("track:lead:0,1,2,3;1,2,3,4").unwrap();
        assert_eq!(path.object, GivenObjectName::Track("lead".into()));
        assert_eq!(path.waypoints.len(), 2);
        let path = parse_path("assets/car:0,1,2,3").unwrap();
        assert_eq!(path.object, GivenObjectName::Asset("assets/car".into()));
        assert!(parse_path("a:0,1").unwrap_err().contains("2 numbers"));
        assert_eq!(parse_range("3..9").unwrap(), [3.0, 9.0]);
        assert_eq!(parse_range("5").unwrap(), [5.0, 5.0]);
        assert!(parse_range("fast").is_err());
    }
}
