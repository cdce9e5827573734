//! The record of one digital driving asset: what it is, where it came from and how good it is on held-out views.

pub use backlot_engine::class::ObjectClass;
use serde::{Deserialize, Serialize};

use super::blob::BlobRef;
use super::clock::UnixMs;
use super::ids::{AssetId, DriveLogId, JobId, MAX_ID_BYTES, slug};

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AssetKind {
    Background,
    Object,
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Usage {
    /// Passed the quality gate: may be placed anywhere its view coverage allows.
    Library,
    /// Good only near its recorded poses.
    ReplayOnly { reason: String },
}

/// What an object asset shows.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ObjectSubject {
    pub class: ObjectClass,
    /// Full extents of the annotated cuboid: length, width, height in metres.
    pub size_m: [f64; 3],
    /// Track of the source log it was trained from.
    pub track_id: String,
}

/// Measured on held-out views; `None` where nothing was held out or there is no LiDAR.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct QualityReport {
    /// Decibels.
    pub psnr_held_out: Option<f64>,
    pub ssim_held_out: Option<f64>,
    /// Metres.
    pub depth_mae_m: Option<f64>,
    pub train_views: u32,
    pub held_out_views: u32,
    pub held_out_frames: Vec<u32>,
    /// Backgrounds: width and height in pixels of the first camera's images as trained.
    #[serde(default)]
    pub image_size_px: Option<(u32, u32)>,
    /// 0..1.
    pub accumulation_in_mask: Option<f64>,
    /// 0..1, lower is better.
    pub halo: Option<f64>,
    /// Views per 15-degree sector, from the object's front turning left.
    pub azimuth_histogram: Vec<u32>,
    pub azimuth_mirrored: Vec<bool>,
    pub train_seconds: f64,
    pub train_rays: u64,
    pub peak_rss_bytes: u64,
    /// Metres.
    pub voxel_size_m: f64,
    pub warnings: Vec<String>,
}

/// What a job hands over for publication; its payload blob is already on stable storage.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct NewAsset {
    /// `None` for a background.
    pub object: Option<ObjectSubject>,
    pub usage: Usage,
    pub payload: BlobRef,
    pub quality: QualityReport,
    /// Trained on synthetic images.
    pub synthetic: bool,
}

/// A published asset.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Asset {
    pub id: AssetId,
    pub source_log: DriveLogId,
    pub job: JobId,
    #[serde(flatten)]
    pub content: NewAsset,
    pub created_at: UnixMs,
    /// A deleted asset stays readable for the snapshots that name it.
    pub deleted_at: Option<UnixMs>,
}

impl Asset {
    /// The asset that `job` publishes; its id is a pure function of its subject and the job.
    pub fn publish(content: NewAsset, source_log: &DriveLogId, job: &JobId, now: UnixMs) -> Self {
        Self {
            id: asset_id(source_log, content.object.as_ref(), job),
            source_log: source_log.clone(),
            job: job.clone(),
            content,
            created_at: now,
            deleted_at: None,
        }
    }

    pub fn kind(&self) -> AssetKind {
        match self.content.object {
            Some(_) => AssetKind::Object,
            None => AssetKind::Background,
        }
    }
}

/// `{log}-background-{job}` or `{log}-{class}-{track}-{job}`, each part shortened so that the whole is an id.
fn asset_id(log: &DriveLogId, object: Option<&ObjectSubject>, job: &JobId) -> AssetId {
    /// Enough of the log's name to be recognised.
    const LOG_BYTES: usize = 20;
    const TRACK_BYTES: usize = 16;
    /// The end of a version 7 UUID is random: two jobs on one log get different assets.
    const JOB_BYTES: usize = 8;
    let job = job.as_str();
    let job = slug(&job[job.len().saturating_sub(JOB_BYTES)..], JOB_BYTES);
    let log = slug(log.as_str(), LOG_BYTES);
    let id = match object {
        None => format!("{log}-background-{job}"),
        Some(object) => {
            let track = slug(&object.track_id, TRACK_BYTES);
            // Two long track ids may share their slug; four digits of a hash keep the assets apart.
            let suffix = if track == object.track_id {
                String::new()
            } else {
                blake3::hash(object.track_id.as_bytes()).to_hex()[..4].to_owned()
            };
            format!("{log}-{}-{track}{suffix}-{job}", object.class.name())
        }
    };
    debug_assert!(id.len() <= MAX_ID_BYTES, "{id}");
    AssetId::new(&id).expect("parts are slugs within the length limit")
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn subject(track_id: &str) -> ObjectSubject {
        ObjectSubject {
            class: ObjectClass::Pedestrian,
            size_m: [1.0; 3],
            track_id: track_id.into(),
        }
    }

    proptest! {
        #[test]
        fn every_track_and_log_makes_an_id(track in ".{0,60}", log in "[a-z0-9][a-z0-9_-]{0,62}") {
            let log = DriveLogId::new(&log).unwrap();
            let job = JobId::new("0195f1c2-aaaa-7bbb-8ccc-0123456789ab").unwrap();
            let id = asset_id(&log, Some(&subject(&track)), &job);
            prop_assert!(id.as_str().ends_with("-456789ab"));
        }
    }

    #[test]
    fn tracks_that_share_a_slug_get_different_ids() {
        let log = DriveLogId::new("street").unwrap();
        let job = JobId::new("0195f1c2").unwrap();
        let ids = ["a b", "a-b", "a+b"].map(|track| asset_id(&log, Some(&subject(track)), &job));
        assert_ne!(ids[0], ids[1]);
        assert_ne!(ids[0], ids[2]);
    }
}
