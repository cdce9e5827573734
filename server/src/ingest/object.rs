//! The training set of one object: its usable frames, cropped, in the frame of its cuboid.

use backlot_engine::camera::{Camera, Rigid};
use backlot_engine::train::ObjectInput;
use backlot_engine::view::{DepthReturn, PixelLabel, Split, TrainView};
use glam::DVec2;

use super::content::LogBlobs;
use super::frame::{FrameError, FrameLoader, LoadedFrame};
use super::held_out::split_frames;
use super::hull::raster;
use super::log_labels::{LogLabels, ObjectLabels};
use super::object_labels::{Crop, Subject, crop_around};
use super::object_plan::{Outline, Rejection, Rejections, TrackPlan, outlines};
use super::raster::{area_average, merge_area};
use crate::domain::drive_log::{DriveLog, MASK_NONE};

/// Foreground pixels without which a view is not worth its rays.
const LEAST_FOREGROUND_PX: usize = 300;
/// Without a mask, returns that must span the object.
const LEAST_RETURNS: usize = 30;
/// Nearer instances may hide this fraction of the projected cuboid.
const MOST_HIDDEN: f64 = 0.1;
/// Crops are shrunk to this: a car beside the camera needs no 1,000 pixels.
const LONGER_SIDE_PX: usize = 480;
/// Views beyond this add time, not knowledge; they are thinned evenly.
const MOST_VIEWS: usize = 60;

/// What one object is trained from.
#[derive(Clone, Debug)]
pub struct ObjectSet {
    pub input: ObjectInput,
    /// Frames that passed every check, before standing ones are thinned.
    pub usable_frames: u32,
    /// Rejections found once masks and returns were looked at, on top of the plan's.
    pub rejected: Rejections,
    /// Object from camera of the training views.
    pub object_from_camera: Vec<Rigid>,
}

/// Builds the training set of a plan's track. `progress` hears (frames done, frames) and says whether to go on.
///
/// # Errors
/// [`FrameError`] of the first frame that cannot be loaded. `Ok(None)` if `progress` said stop.
pub fn object_set<B: LogBlobs>(
    log: &DriveLog,
    blobs: &B,
    labels: &LogLabels,
    plan: &TrackPlan,
    hold_out_every: usize,
    mut progress: impl FnMut(usize, usize) -> bool,
) -> Result<Option<ObjectSet>, FrameError<B::Error>> {
    let track = &log.tracks[plan.track];
    let mut set = ObjectSet {
        input: ObjectInput {
            size_m: track.size_m,
            symmetric: track.class.is_symmetric(),
            ..Default::default()
        },
        usable_frames: 0,
        rejected: Rejections::new(),
        object_from_camera: Vec::new(),
    };
    let mut loader = FrameLoader::new(log, blobs, labels.masks());
    let frames = view_frames(plan);
    let mut views = Vec::with_capacity(frames.len());
    for (done, &index) in frames.iter().enumerate() {
        if !progress(done, frames.len()) {
            return Ok(None);
        }
        let loaded = loader.load(index)?;
        match labels.object(log, blobs, plan.track, &loaded)? {
            Ok((crop, labels)) => {
                let (view, mut points) = object_view(log, plan.track, &loaded, crop, labels);
                set.input.lidar_points.append(&mut points);
                views.push(view);
            }
            Err(reason) => *set.rejected.entry(reason).or_default() += 1,
        }
    }
    set.usable_frames = views.len() as u32;
    split(&mut views, hold_out_every);
    set.object_from_camera = views
        .iter()
        .filter(|v| v.split == Split::Train)
        .map(|v| v.local_from_camera)
        .collect();
    set.input.views = views;
    Ok(Some(set))
}

/// The frames of the plan that become views, thinned evenly if they are too many; indices into the log's frames.
pub(super) fn view_frames(plan: &TrackPlan) -> Vec<usize> {
    let frames = &plan.frames;
    let count = frames.len().min(MOST_VIEWS);
    (0..count)
        .map(|i| frames[i * frames.len() / count])
        .collect()
}

fn split(views: &mut Vec<TrainView>, hold_out_every: usize) {
    let poses: Vec<Rigid> = views.iter().map(|v| v.local_from_camera).collect();
    let mut splits = split_frames(&poses, hold_out_every).into_iter();
    views.retain_mut(|view| match splits.next().flatten() {
        Some(split) => {
            view.split = split;
            true
        }
        None => false,
    });
}

/// Labels of the pixels around a track's object, or why the frame does not show it well enough.
pub(super) fn labelled_object(log: &DriveLog, track: usize, loaded: &LoadedFrame) -> ObjectLabels {
    let seen = outlines(log, &loaded.frame, &loaded.camera);
    let outline = seen
        .iter()
        .find(|o| o.track == track)
        .ok_or(Rejection::OutsideImage)?;
    if let Some(&reason) = loaded.unmasked.get(&track) {
        return Err(reason);
    }
    let size_m = log.tracks[track].size_m;
    let crop = crop_around(&loaded.camera, outline, size_m).ok_or(Rejection::OutsideImage)?;
    let subject = Subject {
        loaded,
        outline,
        seen: &seen,
        size_m,
        crop,
    };
    let labels = match &loaded.instance {
        Some(mask) => {
            require_whole(mask, &subject)?;
            subject.labels_from_mask(mask)
        }
        None => {
            if subject.own_returns().count() < LEAST_RETURNS {
                return Err(Rejection::FewReturns);
            }
            subject.labels_from_returns()
        }
    };
    let foreground = labels.iter().filter(|&&l| l == PixelLabel::Foreground);
    if foreground.count() < LEAST_FOREGROUND_PX {
        return Err(Rejection::TooSmall);
    }
    Ok((crop, labels))
}

/// The view of a labelled crop and the returns on the object in its cuboid's frame.
fn object_view(
    log: &DriveLog,
    track: usize,
    loaded: &LoadedFrame,
    crop: Crop,
    labels: Vec<PixelLabel>,
) -> (TrainView, Vec<[f32; 3]>) {
    let seen = outlines(log, &loaded.frame, &loaded.camera);
    let outline = seen.iter().find(|o| o.track == track);
    let subject = Subject {
        loaded,
        outline: outline.expect("a labelled object is in the image"),
        seen: &seen,
        size_m: log.tracks[track].size_m,
        crop,
    };
    let points = subject
        .own_returns()
        .map(|(_, cuboid_m)| cuboid_m.as_vec3().to_array())
        .collect();
    (cut(&subject, labels), points)
}

/// The mask names the object, and nearer instances hide little of it.
fn require_whole(mask: &[u16], subject: &Subject<'_>) -> Result<(), Rejection> {
    let camera = &subject.loaded.camera;
    let width = camera.width as usize;
    let own = subject.outline.track + 1;
    let is_nearer = |value: u16| {
        value != MASK_NONE && usize::from(value) != own && {
            let nearer = |o: &&Outline| o.track + 1 == usize::from(value);
            let other = subject.seen.iter().find(nearer);
            other.is_none_or(|o| o.distance_m < subject.outline.distance_m)
        }
    };
    let (mut total, mut seen, mut hidden) = (0u32, 0u32, 0u32);
    raster(
        &subject.outline.hull,
        camera.width,
        camera.height,
        |row, columns| {
            for &value in &mask[row * width..][columns] {
                total += 1;
                seen += u32::from(usize::from(value) == own);
                hidden += u32::from(is_nearer(value));
            }
        },
    );
    if seen == 0 {
        return Err(Rejection::NoMask);
    }
    if f64::from(hidden) > MOST_HIDDEN * f64::from(total) {
        return Err(Rejection::Occluded);
    }
    Ok(())
}

fn cut(subject: &Subject<'_>, labels: Vec<PixelLabel>) -> TrainView {
    let Crop {
        x,
        y,
        width,
        height,
    } = subject.crop;
    let loaded = subject.loaded;
    let full = Camera {
        width: width as u32,
        height: height as u32,
        principal_px: subject.in_crop(loaded.camera.principal_px),
        ..loaded.camera
    };
    let divisor = width.max(height).div_ceil(LONGER_SIDE_PX) as u32;
    let from = (full.width, full.height);
    let to = (from.0.div_ceil(divisor), from.1.div_ceil(divisor));
    let camera = full.resized(to.0, to.1);
    let scale = DVec2::new(f64::from(to.0), f64::from(to.1))
        / DVec2::new(f64::from(from.0), f64::from(from.1));
    let rgb: Vec<u8> = (y..y + height)
        .flat_map(|row| {
            let start = (row * loaded.camera.width as usize + x) * 3;
            loaded.rgb[start..start + width * 3].iter().copied()
        })
        .collect();
    let depth = subject
        .own_returns()
        .filter_map(|(r, _)| {
            let at = subject.in_crop(r.pixel);
            let index = at.y as usize * width + at.x as usize;
            (labels.get(index) == Some(&PixelLabel::Foreground)).then(|| DepthReturn {
                pixel: (at * scale).as_vec2().to_array(),
                range_m: r.range_m as f32,
                source: r.source,
                weight: r.weight,
            })
        })
        .collect();
    TrainView {
        frame_index: loaded.frame.frame_index,
        camera,
        local_from_camera: subject.outline.camera_from_cuboid.inverse(),
        rgb: area_average(&rgb, from, to),
        labels: merge_area(&labels, from, to, |a, b| {
            if a == b { a } else { PixelLabel::Unknown }
        }),
        depth,
        split: Split::Train,
    }
}
