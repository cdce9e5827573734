//! The training set of a log's background.

use std::collections::HashSet;

use backlot_engine::scene::{RecordedCamera, RecordedFrame, RecordedTrack, Recording};
use backlot_engine::train::BackgroundInput;
use backlot_engine::view::{DepthReturn, PixelLabel, Split, TrainView};

use super::background_labels::{background_labels, moving_tracks};
use super::content::LogBlobs;
use super::frame::{FrameError, FrameLoader, LoadedFrame};
use super::held_out::split_frames;
use super::raster::{area_average, merge_area};
use crate::domain::drive_log::DriveLog;

/// Points closer together than this seed the same voxels.
const POINT_SPACING_M: f64 = 0.05;

/// What one background is trained from, and how it was made.
#[derive(Clone, Debug)]
pub struct BackgroundSet {
    pub input: BackgroundInput,
    /// Size of the first camera's images as they are trained.
    pub image_size: (u32, u32),
}

/// Builds the training set in the log's local frame. Images are shrunk until their longer side is at most
/// `longer_side_px`. `progress` hears (frames done, frames) and says whether to go on.
///
/// # Errors
/// [`FrameError`] of the first frame that cannot be loaded. `Ok(None)` if `progress` said stop.
pub fn background_set<B: LogBlobs>(
    log: &DriveLog,
    blobs: &B,
    hold_out_every: usize,
    longer_side_px: u32,
    mut progress: impl FnMut(usize, usize) -> bool,
) -> Result<Option<BackgroundSet>, FrameError<B::Error>> {
    let moving = moving_tracks(log);
    let order = time_order(log);
    let splits = splits(log, &order, hold_out_every);
    let mut loader = FrameLoader::new(log, blobs);
    let mut input = BackgroundInput {
        ego_path: order
            .iter()
            .filter_map(|&i| log.world_from_camera(&log.frames[i]))
            .map(|pose| log.local_from_world.point(pose.translation_m))
            .collect(),
        ..Default::default()
    };
    let mut seeds = HashSet::new();
    for (done, &index) in order.iter().enumerate() {
        if !progress(done, order.len()) {
            return Ok(None);
        }
        let Some(split) = splits[index] else { continue };
        let loaded = loader.load(index)?;
        if split == Split::Train {
            add_seeds(log, &moving, &loaded, &mut seeds, &mut input.lidar_points);
        }
        input.views.push(background_view(
            log,
            &moving,
            &loaded,
            split,
            longer_side_px,
        ));
    }
    let camera = &log.cameras[0].camera;
    Ok(Some(BackgroundSet {
        input,
        image_size: trained_size((camera.width, camera.height), longer_side_px),
    }))
}

/// The recorded size divided by the smallest integer that brings the longer side within the limit, rounded up.
pub(crate) fn trained_size(size: (u32, u32), longer_side_px: u32) -> (u32, u32) {
    let divisor = size.0.max(size.1).div_ceil(longer_side_px).max(1);
    (size.0.div_ceil(divisor), size.1.div_ceil(divisor))
}

/// What the background remembers of the log, in the local frame, for composition.
pub(crate) fn recording(log: &DriveLog) -> Recording {
    let order = time_order(log);
    let frames: Vec<(RecordedFrame, i64)> = order
        .iter()
        .filter_map(|&i| {
            let frame = &log.frames[i];
            let world_from_ego = log.world_from_ego.at(frame.timestamp_ns)?;
            let recorded = RecordedFrame {
                camera_id: frame.camera_id.clone(),
                frame_index: frame.frame_index,
                timestamp_ns: frame.timestamp_ns,
                local_from_camera: log.local_from_world * log.world_from_camera(frame)?,
                local_from_ego: log.local_from_world * world_from_ego,
                image: Some(frame.image.digest.to_string()),
                instance_mask: frame.instance_mask.as_ref().map(|b| b.digest.to_string()),
            };
            Some((recorded, frame.timestamp_ns))
        })
        .collect();
    let moving = moving_tracks(log);
    let tracks = log.tracks.iter().zip(moving).map(|(track, moving)| {
        let at = |ns| track.at(ns).map(|pose| log.local_from_world * pose);
        RecordedTrack {
            track_id: track.track_id.clone(),
            class: track.class,
            size_m: track.size_m,
            moving,
            local_from_cuboid: frames.iter().map(|(_, ns)| at(*ns)).collect(),
        }
    });
    Recording {
        cameras: log
            .cameras
            .iter()
            .map(|c| RecordedCamera {
                camera_id: c.camera_id.clone(),
                camera: c.camera,
            })
            .collect(),
        tracks: tracks.collect(),
        sun_direction_local: log
            .sun_direction_world
            .map(|sun| log.local_from_world.direction(sun)),
        daylight: None,
        frames: frames.into_iter().map(|(frame, _)| frame).collect(),
    }
}

/// Frame indices by time, then camera.
pub(crate) fn time_order(log: &DriveLog) -> Vec<usize> {
    let mut order: Vec<usize> = (0..log.frames.len()).collect();
    order.sort_by_key(|&i| (log.frames[i].timestamp_ns, &log.frames[i].camera_id));
    order
}

fn splits(log: &DriveLog, order: &[usize], every: usize) -> Vec<Option<Split>> {
    let mut splits = vec![None; log.frames.len()];
    for camera in &log.cameras {
        let (indices, poses): (Vec<usize>, Vec<_>) = order
            .iter()
            .filter(|&&i| log.frames[i].camera_id == camera.camera_id)
            .filter_map(|&i| Some((i, log.world_from_camera(&log.frames[i])?)))
            .unzip();
        for (index, split) in indices.into_iter().zip(split_frames(&poses, every)) {
            splits[index] = split;
        }
    }
    splits
}

fn background_view(
    log: &DriveLog,
    moving: &[bool],
    loaded: &LoadedFrame,
    split: Split,
    longer_side_px: u32,
) -> TrainView {
    let from = (loaded.camera.width, loaded.camera.height);
    let to = trained_size(from, longer_side_px);
    let camera = loaded.camera.resized(to.0, to.1);
    let full = background_labels(log, moving, loaded);
    let width = from.0 as usize;
    let scale = camera.focal_px / loaded.camera.focal_px;
    let depth = static_returns(loaded, moving)
        .filter(|r| {
            let at = r.pixel.y as usize * width + r.pixel.x as usize;
            full[at] == PixelLabel::Foreground
        })
        .map(|r| DepthReturn {
            pixel: (r.pixel * scale).as_vec2().to_array(),
            range_m: r.range_m as f32,
        })
        .collect();
    TrainView {
        frame_index: loaded.frame.frame_index,
        camera,
        local_from_camera: log.local_from_world * loaded.world_from_camera,
        rgb: area_average(&loaded.rgb, from, to),
        labels: merge_area(&full, from, to, merged_label),
        depth,
        split,
    }
}

/// A pixel that touches something unknown is unknown; one that is only partly sky is scene.
fn merged_label(a: PixelLabel, b: PixelLabel) -> PixelLabel {
    match (a, b) {
        (PixelLabel::Unknown, _) | (_, PixelLabel::Unknown) => PixelLabel::Unknown,
        (PixelLabel::Sky, PixelLabel::Sky) => PixelLabel::Sky,
        _ => PixelLabel::Foreground,
    }
}

fn static_returns<'a>(
    loaded: &'a LoadedFrame,
    moving: &'a [bool],
) -> impl Iterator<Item = &'a super::projected::ProjectedReturn> {
    loaded.returns.iter().filter(|r| {
        let on_mover = r.owner.is_some_and(|owner| moving[owner.track]);
        !on_mover && !r.occluded
    })
}

fn add_seeds(
    log: &DriveLog,
    moving: &[bool],
    loaded: &LoadedFrame,
    seen: &mut HashSet<[i32; 3]>,
    points: &mut Vec<[f32; 3]>,
) {
    for r in static_returns(loaded, moving) {
        let local_m = log.local_from_world.point(r.world_m);
        let cell = (local_m / POINT_SPACING_M).floor().as_ivec3().to_array();
        if seen.insert(cell) {
            points.push(local_m.as_vec3().to_array());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn images_are_shrunk_by_whole_numbers() {
        assert_eq!(trained_size((1242, 375), 800), (621, 188));
        assert_eq!(trained_size((640, 384), 800), (640, 384));
        assert_eq!(trained_size((1920, 1280), 800), (640, 427));
        assert_eq!(trained_size((1242, 375), u32::MAX), (1242, 375));
    }
}
