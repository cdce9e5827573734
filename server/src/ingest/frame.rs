//! One frame of a log, decoded: image, masks, and the LiDAR returns and other depths that fall into it.

use std::collections::BTreeMap;

use backlot_engine::camera::{Camera, Rigid};

use super::content::LogBlobs;
use super::depth_map::map_returns;
use super::free_masks::{LogMasks, MaskSource};
use super::image::{
    ImageError, decode_depth_map, decode_instance_mask, decode_rgb, decode_sky_mask,
};
use super::lidar::{WorldReturn, nearest_sweeps, place_sweep};
use super::matched_masks::MatchedMasks;
use super::object_plan::Rejection;
use super::projected::{ProjectedReturn, project_returns};
use super::sfm::SfmCloud;
use crate::domain::blob::BlobRef;
use crate::domain::drive_log::{CameraFrame, DriveLog};
use crate::error::{ErrorKind, Kinded};
use crate::segment::SegmentError;

/// Sweeps farther in time than this say nothing about a frame: 10 Hz scanners are at most half of it away.
pub(crate) const SWEEP_TOLERANCE_NS: u64 = 120_000_000;

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
    #[error("camera {camera_id}, frame {frame_index}: {source}")]
    Segment {
        camera_id: String,
        frame_index: u32,
        source: SegmentError,
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
            Self::Segment { source, .. } => Some(source.kind()),
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
    /// Tracks without a mask of their own where masks had to be matched, and why.
    pub unmasked: BTreeMap<usize, Rejection>,
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
    /// `None` if instance and sky masks are not wanted.
    masks: Option<&'a MatchedMasks>,
    sweeps: Vec<(usize, Vec<WorldReturn>)>,
    /// Read once.
    sfm: Option<SfmCloud>,
}

impl<'a, B: LogBlobs> FrameLoader<'a, B> {
    /// Without `masks` frames are loaded without instance and sky masks: their labels are known.
    pub(crate) fn new(log: &'a DriveLog, blobs: &'a B, masks: Option<&'a MatchedMasks>) -> Self {
        Self {
            log,
            blobs,
            masks,
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
        let rgb = read_image(self.blobs, frame, "image", &frame.image, |b| {
            decode_rgb(b, size)
        })?;
        let (instance, unmasked, sky) = match self.masks {
            Some(masks) => (
                self.instance(index, &camera, masks)?,
                masks.unmasked(index).clone(),
                self.sky(frame, size)?,
            ),
            None => Default::default(),
        };
        self.read_sweeps(frame)?;
        let placed: Vec<_> = self.sweeps.iter().flat_map(|(_, r)| r).copied().collect();
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
            unmasked,
            sky,
            returns,
        })
    }

    /// The sweeps of the last frame: index in the log, and the returns.
    pub(crate) fn sweeps(&self) -> &[(usize, Vec<WorldReturn>)] {
        &self.sweeps
    }

    fn instance(
        &self,
        index: usize,
        camera: &Camera,
        masks: &MatchedMasks,
    ) -> Result<Option<Vec<u16>>, FrameError<B::Error>> {
        let frame = &self.log.frames[index];
        let Some(blob) = &frame.instance_mask else {
            let free = LogMasks(self.blobs).free_masks(frame, camera)?;
            return Ok(free.map(|free| masks.tie(index, free)));
        };
        let size = (camera.width, camera.height);
        let decode = |bytes: &[u8]| decode_instance_mask(bytes, size);
        read_image(self.blobs, frame, "instance mask", blob, decode).map(Some)
    }

    fn sky(
        &self,
        frame: &CameraFrame,
        size: (u32, u32),
    ) -> Result<Option<Vec<u8>>, FrameError<B::Error>> {
        let Some(blob) = &frame.sky_mask else {
            return Ok(None);
        };
        let decode = |bytes: &[u8]| decode_sky_mask(bytes, size);
        read_image(self.blobs, frame, "sky mask", blob, decode).map(Some)
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
        let decode = |bytes: &[u8]| decode_depth_map(bytes, size);
        let units = read_image(self.blobs, frame, "depth map", &map.image, decode)?;
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

    /// Reads the sweeps that belong to a frame, so that [`Self::sweeps`] has them.
    pub(super) fn read_sweeps(&mut self, frame: &CameraFrame) -> Result<(), FrameError<B::Error>> {
        let wanted = nearest_sweeps(self.log, frame.timestamp_ns, SWEEP_TOLERANCE_NS);
        self.sweeps.retain(|(i, _)| wanted.contains(i));
        for i in wanted {
            if self.sweeps.iter().all(|(held, _)| *held != i) {
                let sweep = &self.log.sweeps[i];
                let bytes = self.blobs.read(&sweep.points).map_err(FrameError::Blob)?;
                self.sweeps.push((i, place_sweep(self.log, sweep, &bytes)));
            }
        }
        Ok(())
    }
}

/// Reads and decodes an image or a mask of a frame; `what` names it in errors.
pub(super) fn read_image<B: LogBlobs, T>(
    blobs: &B,
    frame: &CameraFrame,
    what: &'static str,
    blob: &BlobRef,
    decode: impl FnOnce(&[u8]) -> Result<T, ImageError>,
) -> Result<T, FrameError<B::Error>> {
    let bytes = blobs.read(blob).map_err(FrameError::Blob)?;
    decode(&bytes).map_err(|source| FrameError::Content {
        camera_id: frame.camera_id.clone(),
        frame_index: frame.frame_index,
        what,
        source,
    })
}
