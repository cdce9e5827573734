//! The arguments: the contract with people and scripts.

mod logs;

use std::path::PathBuf;

use backlot_engine::backend::DeviceChoice;
use clap::{Args, Parser, Subcommand, ValueEnum};

pub(crate) use logs::{
    Depth, DepthKind, InspectOptions, LogFormat, LogParts, LogsCommand, StreetOptions,
    UploadOptions,
};

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
