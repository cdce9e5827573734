//! The training set of a log's background.

use std::collections::HashMap;

use backlot_engine::scene::{RecordedCamera, RecordedFrame, RecordedTrack, Recording};
use backlot_engine::train::BackgroundInput;
use backlot_engine::view::{DepthReturn, DepthSource, PixelLabel, Split, TrainView};

use super::background_labels::moving_tracks;
use super::beams::Beams;
use super::between::sweeps_between;
use super::content::LogBlobs;
use super::frame::{FrameError, FrameLoader, LoadedFrame};
use super::held_out::split_frames;
use super::lidar::place_sweep;
use super::log_labels::LogLabels;
use super::projected::ProjectedReturn;
use super::raster::{area_average, merge_area};
use super::seeds::Seeds;
use super::tied_masks::TiedMask;
use crate::domain::drive_log::{CameraFrame, DriveLog};

/// Samples of a depth map that a view keeps: a few times a scanner's returns, so that a log of maps fits in memory.
const MOST_MAP_SAMPLES: usize = 8_000;

/// What one background is trained from, and how it was made.
#[derive(Clone, Debug)]
pub struct BackgroundSet {
    pub input: BackgroundInput,
    /// Size of the first camera's images as they are trained.
    pub image_size: (u32, u32),
    /// For the quality report: where depth comes from if not from LiDAR, or that there is none.
    pub depth_warning: Option<String>,
}

/// Builds the training set in the log's local frame. Images are shrunk until their longer side is at most
/// `longer_side_px`. `progress` hears (frames done, frames) and says whether to go on.
///
/// # Errors
/// [`FrameError`] of the first frame that cannot be loaded. `Ok(None)` if `progress` said stop.
pub fn background_set<B: LogBlobs>(
    log: &DriveLog,
    blobs: &B,
    labels: &LogLabels,
    hold_out_every: usize,
    longer_side_px: u32,
    mut progress: impl FnMut(usize, usize) -> bool,
) -> Result<Option<BackgroundSet>, FrameError<B::Error>> {
    let moving = moving_tracks(log);
    let order = time_order(log);
    let splits = splits(log, &order, hold_out_every);
    let mut loader = FrameLoader::new(log, blobs, labels.masks());
    let mut input = BackgroundInput {
        ego_path: order
            .iter()
            .filter_map(|&i| log.world_from_camera(&log.frames[i]))
            .map(|pose| log.local_from_world.point(pose.translation_m))
            .collect(),
        ..Default::default()
    };
    let mut seeds = Seeds::new(log, &splits);
    let mut beams = Beams::new(log, &splits);
    let mut view_times_ns = Vec::new();
    for (done, &index) in order.iter().enumerate() {
        if !progress(done, order.len()) {
            return Ok(None);
        }
        let Some(split) = splits[index] else { continue };
        let loaded = loader.load(index)?;
        let labels = labels.background(log, blobs, &moving, &loaded)?;
        let depths = static_depths(&loaded, &moving, &labels);
        if split == Split::Train {
            let view = input.views.len() as u32;
            view_times_ns.push((loaded.frame.timestamp_ns, view));
            let surfaces = depths.iter().map(|r| log.local_from_world.point(r.world_m));
            surfaces.for_each(|p| seeds.add(p));
            for (sweep, returns) in loader.sweeps() {
                if beams.take(*sweep) {
                    beams.add(log, returns, view, &mut input.beams);
                    seeds.add_sweep(log, returns, &moving);
                }
            }
        }
        let view = background_view(log, &loaded, &labels, &depths, longer_side_px);
        input.views.push(TrainView { split, ..view });
    }
    for index in sweeps_between(log, beams.done()) {
        if !progress(order.len(), order.len()) {
            return Ok(None);
        }
        let sweep = &log.sweeps[index];
        let nearest = view_times_ns
            .iter()
            .min_by_key(|(time, _)| time.abs_diff(sweep.timestamp_ns));
        let Some((_, view)) = nearest else { break };
        let bytes = blobs.read(&sweep.points).map_err(FrameError::Blob)?;
        let returns = place_sweep(log, sweep, &bytes);
        beams.add(log, &returns, *view, &mut input.beams);
        seeds.add_sweep(log, &returns, &moving);
    }
    input.lidar_points = seeds.points;
    let camera = &log.cameras[0].camera;
    Ok(Some(BackgroundSet {
        depth_warning: depth_warning(&input.views),
        input,
        image_size: trained_size((camera.width, camera.height), longer_side_px),
    }))
}

/// The recorded size divided by the smallest integer that brings the longer side within the limit, rounded up.
pub(crate) fn trained_size(size: (u32, u32), longer_side_px: u32) -> (u32, u32) {
    let divisor = size.0.max(size.1).div_ceil(longer_side_px).max(1);
    (size.0.div_ceil(divisor), size.1.div_ceil(divisor))
}

/// What the background remembers of the log, in the local frame, for composition. Frames whose log has no mask that names its tracks
/// get the one of `tied`, if there is one.
pub(crate) fn recording(log: &DriveLog, tied: &[TiedMask]) -> Recording {
    let order = time_order(log);
    let tied: HashMap<(&str, u32), &TiedMask> = tied
        .iter()
        .map(|mask| ((mask.camera_id.as_str(), mask.frame_index), mask))
        .collect();
    let mask = |frame: &CameraFrame| {
        let tied = tied.get(&(frame.camera_id.as_str(), frame.frame_index));
        let mask = frame.instance_mask.or_else(|| tied.map(|tied| tied.mask));
        mask.map(|blob| blob.digest.to_string())
    };
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
                instance_mask: mask(frame),
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

/// Whether each frame of the log is in the background's training set; a standing camera's frames are thinned.
pub(super) fn background_frames(log: &DriveLog) -> Vec<bool> {
    // Which frames are held out of training does not change which there are.
    let splits = splits(log, &time_order(log), 0);
    splits.iter().map(Option::is_some).collect()
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
    loaded: &LoadedFrame,
    full: &[PixelLabel],
    returns: &[&ProjectedReturn],
    longer_side_px: u32,
) -> TrainView {
    let from = (loaded.camera.width, loaded.camera.height);
    let to = trained_size(from, longer_side_px);
    let camera = loaded.camera.resized(to.0, to.1);
    let scale = camera.focal_px / loaded.camera.focal_px;
    let depth = returns.iter().map(|r| DepthReturn {
        pixel: (r.pixel * scale).as_vec2().to_array(),
        range_m: r.range_m as f32,
        source: r.source,
        weight: r.weight,
    });
    TrainView {
        frame_index: loaded.frame.frame_index,
        camera,
        local_from_camera: log.local_from_world * loaded.world_from_camera,
        rgb: area_average(&loaded.rgb, from, to),
        labels: merge_area(full, from, to, merged_label),
        depth: depth.collect(),
        split: Split::Train,
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

/// What supervises a frame's pixels of the static scene.
fn static_depths<'a>(
    loaded: &'a LoadedFrame,
    moving: &[bool],
    labels: &[PixelLabel],
) -> Vec<&'a ProjectedReturn> {
    let width = loaded.camera.width as usize;
    let is_scene = |r: &ProjectedReturn| {
        labels[r.pixel.y as usize * width + r.pixel.x as usize] == PixelLabel::Foreground
    };
    let of_maps = loaded
        .returns
        .iter()
        .filter(|r| r.source == DepthSource::Map);
    let nth = of_maps.count().div_ceil(MOST_MAP_SAMPLES).max(1);
    let mut maps_seen = 0;
    let mut depths = Vec::new();
    for r in &loaded.returns {
        if r.source == DepthSource::Map {
            maps_seen += 1;
            if maps_seen % nth != 0 {
                continue;
            }
        }
        let on_mover = r.owner.is_some_and(|owner| moving[owner.track]);
        if !on_mover && !r.occluded && is_scene(r) {
            depths.push(r);
        }
    }
    depths
}

/// What the report says about a background whose depth is not LiDAR's; `None` if LiDAR hit the static scene.
fn depth_warning(views: &[TrainView]) -> Option<String> {
    let has = |source| {
        let mut depths = views.iter().flat_map(|view| &view.depth);
        depths.any(|d| d.source == source)
    };
    let sources = match (has(DepthSource::Map), has(DepthSource::SfmPoint)) {
        _ if has(DepthSource::Lidar) => return None,
        (false, false) => {
            let what =
                "no LiDAR, depth map or SfM point on the static scene: trained without depth";
            return Some(what.to_owned());
        }
        (true, false) => "depth maps",
        (false, true) => "SfM points",
        (true, true) => "depth maps and SfM points",
    };
    Some(format!(
        "no LiDAR on the static scene: depth is that of the log's {sources}, and so are its errors"
    ))
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
