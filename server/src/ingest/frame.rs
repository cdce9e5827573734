//! One frame of a log, decoded: image, masks, and the LiDAR returns and other depths that fall into it.

use backlot_engine::camera::{Camera, Rigid};

use super::content::LogBlobs;
use super::depth_map::map_returns;
use super::image::{
    ImageError, decode_depth_map, decode_instance_mask, decode_rgb, decode_sky_mask,
};
use super::lidar::{WorldReturn, nearest_sweeps, place_sweep};
use super::projected::{ProjectedReturn, project_returns};
use super::sfm::SfmCloud;
use crate::domain::drive_log::{CameraFrame, DriveLog};
use crate::error::ErrorKind;

/// Sweeps farther in time than this say nothing about a frame: 10 Hz scanners are at most half of it away.
const SWEEP_TOLERANCE_NS: u64 = 120_000_000;

/// Why a frame of a validated log cannot be loaded.
#[derive(Debug, thiserror::Error)]
pub enum FrameError<E> {
    /// The blob store's own error.
    #[error(transparent)]
    Blob(E),
    /// Validation let it through, so the blob or the manifest is not what was validated.
    #[error("camera {camera_id}, frame {frame_index}: {what} {source}")]
    Content {
        camera_id: String,
        frame_index: u32,
        what: &'static str,
        source: ImageError,
    },
    #[error("camera {camera_id}, frame {frame_index}: {what}")]
    Manifest {
        camera_id: String,
        frame_index: u32,
        what: &'static str,
    },
}

impl<E> FrameError<E> {
    /// `None` for the blob store's own error, which knows its kind itself.
    pub fn kind(&self) -> Option<ErrorKind> {
        match self {
            Self::Blob(_) => None,
            Self::Content { source, .. } => Some(source.kind()),
            Self::Manifest { .. } => Some(ErrorKind::Invalid),
        }
    }
}

/// A decoded frame at the recorded resolution.
#[derive(Clone, Debug)]
pub(crate) struct LoadedFrame {
    pub frame: CameraFrame,
    pub camera: Camera,
    pub world_from_camera: Rigid,
    /// sRGB, row-major.
    pub rgb: Vec<u8>,
    /// As `CameraFrame::instance_mask`.
    pub instance: Option<Vec<u16>>,
    /// 255 = sky.
    pub sky: Option<Vec<u8>>,
    /// LiDAR returns, then samples of the depth map, then points of structure from motion.
    pub returns: Vec<ProjectedReturn>,
}

/// Loads frames one after another; keeps the sweeps of the last one, which the next camera often shares.
#[derive(Debug)]
pub(crate) struct FrameLoader<'a, B> {
    log: &'a DriveLog,
    blobs: &'a B,
    sweeps: Vec<(usize, Vec<WorldReturn>)>,
    /// Read once.
    sfm: Option<SfmCloud>,
}

impl<'a, B: LogBlobs> FrameLoader<'a, B> {
    pub(crate) fn new(log: &'a DriveLog, blobs: &'a B) -> Self {
        Self {
            log,
            blobs,
            sweeps: Vec::new(),
            sfm: None,
        }
    }

    /// Loads the frame at `index` of the log's frames.
    pub(crate) fn load(&mut self, index: usize) -> Result<LoadedFrame, FrameError<B::Error>> {
        let frame = &self.log.frames[index];
        let manifest = |what| FrameError::Manifest {
            camera_id: frame.camera_id.clone(),
            frame_index: frame.frame_index,
            what,
        };
        let camera = self
            .log
            .camera(&frame.camera_id)
            .ok_or_else(|| manifest("unknown camera"))?
            .camera;
        let world_from_camera = self
            .log
            .world_from_camera(frame)
            .ok_or_else(|| manifest("outside the ego trajectory"))?;
        let size = (camera.width, camera.height);
        let rgb = self.image(frame, "image", &frame.image, |b| decode_rgb(b, size))?;
        let instance = match &frame.instance_mask {
            Some(blob) => Some(self.image(frame, "instance mask", blob, |b| {
                decode_instance_mask(b, size)
            })?),
            None => None,
        };
        let sky = match &frame.sky_mask {
            Some(blob) => Some(self.image(frame, "sky mask", blob, |b| decode_sky_mask(b, size))?),
            None => None,
        };
        let placed = self.place_sweeps(frame)?;
        let mut returns = project_returns(
            &placed,
            &self.log.tracks,
            &camera,
            &world_from_camera,
            frame.timestamp_ns,
        );
        returns.extend(self.map_returns(frame, &camera, &world_from_camera)?);
        self.read_sfm()?;
        if let Some(cloud) = &self.sfm {
            returns.extend(cloud.returns(self.log, index, &camera, &world_from_camera));
        }
        Ok(LoadedFrame {
            frame: frame.clone(),
            camera,
            world_from_camera,
            rgb,
            instance,
            sky,
            returns,
        })
    }

    fn image<T>(
        &self,
        frame: &CameraFrame,
        what: &'static str,
        blob: &crate::domain::blob::BlobRef,
        decode: impl FnOnce(&[u8]) -> Result<T, ImageError>,
    ) -> Result<T, FrameError<B::Error>> {
        let bytes = self.blobs.read(blob).map_err(FrameError::Blob)?;
        decode(&bytes).map_err(|source| FrameError::Content {
            camera_id: frame.camera_id.clone(),
            frame_index: frame.frame_index,
            what,
            source,
        })
    }

    fn map_returns(
        &self,
        frame: &CameraFrame,
        camera: &Camera,
        world_from_camera: &Rigid,
    ) -> Result<Vec<ProjectedReturn>, FrameError<B::Error>> {
        let Some(map) = &frame.depth_map else {
            return Ok(Vec::new());
        };
        let size = (camera.width, camera.height);
        let units = self.image(frame, "depth map", &map.image, |b| {
            decode_depth_map(b, size)
        })?;
        let at_ns = frame.timestamp_ns;
        let placed = map_returns(self.log, at_ns, map, &units, camera, world_from_camera);
        Ok(placed)
    }

    fn read_sfm(&mut self) -> Result<(), FrameError<B::Error>> {
        if let (None, Some(sfm)) = (&self.sfm, &self.log.sfm_points) {
            let read = |blob| self.blobs.read(blob).map_err(FrameError::Blob);
            let points = read(&sfm.points)?;
            let observations = sfm.observations.as_ref().map(read).transpose()?;
            let frames = self.log.frames.len();
            let cloud = SfmCloud::new(sfm, &points, observations.as_deref(), frames);
            self.sfm = Some(cloud);
        }
        Ok(())
    }

    fn place_sweeps(
        &mut self,
        frame: &CameraFrame,
    ) -> Result<Vec<WorldReturn>, FrameError<B::Error>> {
        let wanted = nearest_sweeps(self.log, frame.timestamp_ns, SWEEP_TOLERANCE_NS);
        self.sweeps.retain(|(i, _)| wanted.contains(i));
        for i in wanted {
            if self.sweeps.iter().all(|(held, _)| *held != i) {
                let sweep = &self.log.sweeps[i];
                let bytes = self.blobs.read(&sweep.points).map_err(FrameError::Blob)?;
                self.sweeps.push((i, place_sweep(self.log, sweep, &bytes)));
            }
        }
        Ok(self.sweeps.iter().flat_map(|(_, r)| r).copied().collect())
    }
}
