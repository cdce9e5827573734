//! The log that goes in, and what is known about it beyond the log itself.

use anyhow::{Context, ensure};
use backlot_client::generator::{StreetConfig, StreetWorld, View};
use backlot_client::geometry::rigid_from_wire;
use backlot_client::motion::ego_pose_at;
use backlot_client::read_log::ReadLog;
use backlot_engine::camera::Camera;
use backlot_proto::v1;
use glam::DVec2;
use image::RgbImage;

use crate::args::{DemoOptions, LogFormat};
use crate::input;

/// A log and, for a generated one, the street that answers any question about it exactly.
pub(crate) struct Source {
    pub log: ReadLog,
    pub street: Option<StreetWorld>,
    /// Name on the server.
    pub name: String,
}

impl Source {
    /// Reads the log that the options name, or generates the default one.
    pub(crate) fn open(options: &DemoOptions) -> anyhow::Result<Self> {
        match (&options.log, options.format) {
            (Some(path), Some(format @ (LogFormat::KittiRaw | LogFormat::KittiTracking))) => {
                Ok(Self {
                    log: input::read_folder(path, Some(format), &options.parts)?,
                    street: None,
                    name: format!("driveLogs/{}", id_of(path)),
                })
            }
            (None, None | Some(LogFormat::Generated)) => {
                let config = StreetConfig {
                    seed: options.seed,
                    ..StreetConfig::default()
                };
                Self::generate(&config, &format!("driveLogs/street-{}", options.seed))
            }
            (None, Some(_)) => anyhow::bail!("--format of a recorded log needs --log PATH"),
            (Some(_), _) => anyhow::bail!(
                "the demo measures one rectified camera: --log PATH needs --format kitti-raw or kitti-tracking; upload other logs"
            ),
        }
    }

    pub(crate) fn generate(config: &StreetConfig, name: &str) -> anyhow::Result<Self> {
        let street = StreetWorld::new(config)?;
        Ok(Self {
            log: street.read_log()?,
            street: Some(street),
            name: name.to_owned(),
        })
    }

    pub(crate) fn frame(&self, frame_index: u32) -> anyhow::Result<&v1::CameraFrame> {
        let mut frames = self.log.drive_log.frames.iter();
        frames
            .find(|frame| frame.frame_index == frame_index)
            .with_context(|| format!("the log has no frame {frame_index}"))
    }

    /// The recorded image of a frame.
    pub(crate) fn image(&self, frame: &v1::CameraFrame) -> anyhow::Result<RgbImage> {
        let digest = frame.image.as_ref().map(|blob| blob.digest.as_str());
        let source = digest.and_then(|digest| self.log.blobs.get(digest));
        let content = source.context("a frame has no image")?.read()?;
        Ok(image::load_from_memory(&content)?.into_rgb8())
    }

    /// Camera and pose of a frame as recorded.
    pub(crate) fn view(&self, frame: &v1::CameraFrame) -> anyhow::Result<View> {
        let mut cameras = self.log.drive_log.cameras.iter();
        let camera = cameras
            .find(|camera| camera.camera_id == frame.camera_id)
            .context("a frame names an unknown camera")?;
        ensure!(
            camera.distortion.is_none(),
            "the demo measures undistorted cameras only"
        );
        let poses = &self.log.drive_log.world_from_ego;
        let world_from_ego = ego_pose_at(poses, frame.timestamp_ns)
            .context("a frame lies outside the ego trajectory")?;
        Ok(View {
            camera: Camera {
                width: camera.width,
                height: camera.height,
                focal_px: DVec2::new(camera.focal_x_px, camera.focal_y_px),
                principal_px: DVec2::new(camera.principal_x_px, camera.principal_y_px),
                distortion: Default::default(),
            },
            world_from_camera: world_from_ego * rigid_from_wire(camera.ego_from_camera.as_ref()),
        })
    }
}

/// A resource id from the folder's name.
fn id_of(path: &std::path::Path) -> String {
    let name = path.file_name().map(|n| n.to_string_lossy().to_lowercase());
    let name = name.unwrap_or_default();
    let allowed = |c: char| if c.is_ascii_alphanumeric() { c } else { '-' };
    let id: String = name.chars().map(allowed).take(63).collect();
    let id = id.trim_start_matches('-');
    if id.is_empty() { "recorded" } else { id }.to_owned()
}
