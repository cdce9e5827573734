//! Configuration: what was written (file, environment, command line) and the checked form that the server takes.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::time::Duration;

use backlot_engine::backend::DeviceChoice;
use serde::Deserialize;

use crate::error::{ErrorKind, Kinded};
use crate::ingest::MaskMatching;
use crate::segment::{RawSegmenter, SegmenterSettings};

/// Free space under which uploads are refused: an asset being published still fits.
const LOW_WATER_BYTES: u64 = 64 << 20;

/// Enough for the index to open on a full disk.
const BALLAST_BYTES: u64 = 16 << 20;

/// Time that a stopping server gives running calls and jobs.
const DRAIN_GRACE: Duration = Duration::from_secs(10);

/// Assets kept on a GPU between calls: a street of 60 m takes about 200 MiB, a dense background of 36 M voxels 1.9 GiB.
const GPU_MEMORY_BYTES: u64 = 4 << 30;

/// More threads than any machine has cores is a typing error.
const MAX_THREADS: usize = 1024;

/// The checked configuration of a server.
#[derive(Clone, Debug, PartialEq)]
pub struct Config {
    pub data_dir: PathBuf,
    /// Port 0 takes a free port.
    pub listen: SocketAddr,
    /// Jobs that run at once.
    pub workers: usize,
    /// Threads of the engine, shared by all jobs and renderings; 0 means one a core.
    pub threads: usize,
    /// What renders.
    pub device: DeviceChoice,
    /// Assets beyond this are dropped from a GPU, those longest unused first.
    pub gpu_memory_bytes: u64,
    /// When an instance mask that is not tied to a track is taken for a track's.
    pub mask_matching: MaskMatching,
    /// What finds masks where a log brings none; `None` leaves it to LiDAR returns.
    pub segmenter: Option<SegmenterSettings>,
    pub drain_grace: Duration,
    /// Uploads are refused while less than this is free on the data directory's file system.
    pub low_water_bytes: u64,
    /// Size of the file that is given back when the disk is full at start.
    pub ballast_bytes: u64,
}

impl Config {
    /// One worker, one engine thread a core, and the default limits.
    pub fn new(data_dir: impl Into<PathBuf>, listen: SocketAddr) -> Self {
        Self {
            data_dir: data_dir.into(),
            listen,
            workers: 1,
            threads: 0,
            device: DeviceChoice::default(),
            gpu_memory_bytes: GPU_MEMORY_BYTES,
            mask_matching: MaskMatching::default(),
            segmenter: None,
            drain_grace: DRAIN_GRACE,
            low_water_bytes: LOW_WATER_BYTES,
            ballast_bytes: BALLAST_BYTES,
        }
    }
}

/// The configuration as written; every value may be absent.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RawConfig {
    pub data_dir: Option<PathBuf>,
    pub listen: Option<String>,
    pub workers: Option<usize>,
    pub threads: Option<usize>,
    pub device: Option<String>,
    pub gpu_memory_mib: Option<u64>,
    pub mask_iou: Option<f64>,
    pub mask_follow_iou: Option<f64>,
    pub segmenter: Option<RawSegmenter>,
    pub drain_grace_s: Option<u64>,
    pub low_water_mib: Option<u64>,
    pub ballast_mib: Option<u64>,
}

impl RawConfig {
    /// Reads a TOML file.
    pub fn read(path: &Path) -> Result<Self, Error> {
        let text = std::fs::read_to_string(path).map_err(|source| Error::Read {
            path: path.to_owned(),
            source,
        })?;
        toml::from_str(&text).map_err(|source| Error::Parse {
            path: path.to_owned(),
            source: Box::new(source),
        })
    }

    /// Values of `self`, and of `base` where `self` has none.
    pub fn over(self, base: Self) -> Self {
        Self {
            data_dir: self.data_dir.or(base.data_dir),
            listen: self.listen.or(base.listen),
            workers: self.workers.or(base.workers),
            threads: self.threads.or(base.threads),
            device: self.device.or(base.device),
            gpu_memory_mib: self.gpu_memory_mib.or(base.gpu_memory_mib),
            mask_iou: self.mask_iou.or(base.mask_iou),
            mask_follow_iou: self.mask_follow_iou.or(base.mask_follow_iou),
            segmenter: self.segmenter.or(base.segmenter),
            drain_grace_s: self.drain_grace_s.or(base.drain_grace_s),
            low_water_mib: self.low_water_mib.or(base.low_water_mib),
            ballast_mib: self.ballast_mib.or(base.ballast_mib),
        }
    }

    /// Checks every value and fills the defaults in.
    pub fn check(self) -> Result<Config, Error> {
        let data_dir = self.data_dir.ok_or(Error::Missing { key: "data_dir" })?;
        let text = self.listen.ok_or(Error::Missing { key: "listen" })?;
        let listen = text.parse().map_err(|_| Error::Value {
            key: "listen",
            why: format!("\"{text}\" is not ADDRESS:PORT"),
        })?;
        let defaults = Config::new(data_dir, listen);
        let mib = |value: Option<u64>, default: u64| {
            value.map_or(default, |mib| mib.saturating_mul(1 << 20))
        };
        Ok(Config {
            workers: count("workers", self.workers, defaults.workers, 1)?,
            threads: count("threads", self.threads, defaults.threads, 0)?,
            device: device(self.device)?,
            gpu_memory_bytes: mib(self.gpu_memory_mib, defaults.gpu_memory_bytes),
            mask_matching: mask_matching(self.mask_iou, self.mask_follow_iou)?,
            segmenter: segmenter(self.segmenter)?,
            drain_grace: self
                .drain_grace_s
                .map_or(defaults.drain_grace, Duration::from_secs),
            low_water_bytes: mib(self.low_water_mib, defaults.low_water_bytes),
            ballast_bytes: mib(self.ballast_mib, defaults.ballast_bytes),
            ..defaults
        })
    }
}

fn mask_matching(iou: Option<f64>, follow_iou: Option<f64>) -> Result<MaskMatching, Error> {
    let defaults = MaskMatching::default();
    Ok(MaskMatching {
        least_iou: overlap("mask_iou", iou, defaults.least_iou)?,
        least_follow_iou: overlap("mask_follow_iou", follow_iou, defaults.least_follow_iou)?,
        ..defaults
    })
}

fn segmenter(written: Option<RawSegmenter>) -> Result<Option<SegmenterSettings>, Error> {
    let checked = written.map(RawSegmenter::check).transpose();
    checked.map_err(|(key, why)| Error::Value { key, why })
}

/// An intersection over union that can be demanded. Below 0.05 anything would do.
fn overlap(key: &'static str, value: Option<f64>, default: f64) -> Result<f64, Error> {
    let value = value.unwrap_or(default);
    if (0.05..=1.0).contains(&value) {
        return Ok(value);
    }
    Err(Error::Value {
        key,
        why: format!("{value} is not between 0.05 and 1"),
    })
}

fn device(written: Option<String>) -> Result<DeviceChoice, Error> {
    let choice = written.map_or(Ok(DeviceChoice::default()), |text| text.parse());
    choice.map_err(|error| Error::Value {
        key: "device",
        why: error.to_string(),
    })
}

fn count(
    key: &'static str,
    value: Option<usize>,
    default: usize,
    least: usize,
) -> Result<usize, Error> {
    let value = value.unwrap_or(default);
    if (least..=MAX_THREADS).contains(&value) {
        return Ok(value);
    }
    Err(Error::Value {
        key,
        why: format!("{value} is not between {least} and {MAX_THREADS}"),
    })
}

#[derive(Debug, thiserror::Error)]
pub enum Error {
    #[error("read {}: {source}", path.display())]
    Read {
        path: PathBuf,
        source: std::io::Error,
    },
    #[error("parse {}: {source}", path.display())]
    Parse {
        path: PathBuf,
        source: Box<toml::de::Error>,
    },
    #[error("{key} is not set")]
    Missing { key: &'static str },
    #[error("{key}: {why}")]
    Value { key: &'static str, why: String },
}

impl Kinded for Error {
    fn kind(&self) -> ErrorKind {
        ErrorKind::Invalid
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_file_of_the_container_is_valid() {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docker/server.toml");
        let config = RawConfig::read(&path).unwrap().check().unwrap();
        assert_eq!(config.listen.port(), 50051);
    }

    #[test]
    fn the_command_line_wins_over_the_file() {
        let file: RawConfig = toml::from_str("listen = \"127.0.0.1:1\"\nworkers = 3").unwrap();
        let line = RawConfig {
            data_dir: Some("d".into()),
            listen: Some("127.0.0.1:2".into()),
            ..RawConfig::default()
        };
        let config = line.over(file).check().unwrap();
        assert_eq!((config.listen.port(), config.workers), (2, 3));
    }

    #[test]
    fn wrong_values_are_named() {
        let check = |text: &str| {
            let raw: RawConfig = toml::from_str(text).unwrap();
            raw.check().unwrap_err().to_string()
        };
        assert!(check("listen = \"127.0.0.1:1\"").contains("data_dir"));
        assert!(check("data_dir = \"d\"\nlisten = \"here\"").contains("\"here\""));
        assert!(check("data_dir = \"d\"\nlisten = \"[::]:1\"\nworkers = 0").contains("workers"));
        let device = "data_dir = \"d\"\nlisten = \"[::]:1\"\ndevice = \"cuda\"";
        assert!(check(device).contains("device: \"cuda\""));
        for value in ["0", "1.5", "nan"] {
            let text = format!("data_dir = \"d\"\nlisten = \"[::]:1\"\nmask_iou = {value}");
            assert!(check(&text).contains("mask_iou"), "{value}");
        }
        assert!(toml::from_str::<RawConfig>("worker = 1").is_err());
    }
}
