//! Chooses a recorded pose and what stands in the scene: a pure function of (stage, library, recipe, seed, index).

use std::collections::BTreeMap;

use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::collision::Occupied;
use super::placement::Placer;
use super::projection::amodal_box;
use super::random::Draws;
use super::recipe::Recipe;
use super::recording::{RecordedTrack, Recording};
use super::rejection::Rejection;
use super::valid_region::ValidRegion;
use crate::asset::{AssetHeader, Usage};
use crate::camera::{Camera, Rigid};
use crate::class::ObjectClass;
use crate::quality::ViewCoverage;
use crate::{Error, Result};

/// The background as composition sees it.
#[derive(Clone, Copy, Debug)]
pub struct Stage<'a> {
    pub source_log: &'a str,
    pub recording: &'a Recording,
    pub region: &'a ValidRegion,
}

/// An object asset as composition sees it.
#[derive(Clone, Debug)]
pub struct Candidate {
    /// Asset name.
    pub name: String,
    pub class: ObjectClass,
    pub size_m: DVec3,
    pub source_log: String,
    pub source_track_id: String,
    /// Whether it may be placed anywhere; otherwise it only replays its own track.
    pub library: bool,
    pub coverage: ViewCoverage,
    /// Where it was recorded, relative to its ego; the `paper` presets jitter these. May be empty.
    pub ego_from_object: Vec<Rigid>,
}

impl Candidate {
    /// From an object asset's header.
    pub fn from_header(name: &str, header: &AssetHeader) -> Self {
        Self {
            name: name.to_owned(),
            class: header.class,
            size_m: header.size_m,
            source_log: header.source_log.clone(),
            source_track_id: header.source_track_id.clone(),
            library: header.usage == Usage::Library,
            coverage: header.coverage.clone().unwrap_or_default(),
            ego_from_object: header.ego_from_object.clone(),
        }
    }
}

/// Where an object of a sample comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Origin {
    /// Placed by the recipe.
    Inserted,
    /// Placed in the slot of an original mover.
    Replaced,
    /// An original mover, rendered at its recorded pose.
    Replayed,
    /// An original mover without an asset, shown by the recorded image's own pixels.
    Recorded,
    /// An original static object, part of the background.
    Static,
}

/// One object of a sample, in the background's local frame.
#[derive(Clone, Debug, PartialEq)]
pub struct PlacedObject {
    /// 1.. within the sample.
    pub instance_id: u16,
    pub origin: Origin,
    pub class: ObjectClass,
    pub size_m: DVec3,
    pub local_from_object: Rigid,
    /// Index into the library passed to [`compose`]; `None` for static and recorded originals.
    pub asset: Option<usize>,
    /// Originals: their track. Replaced: the track whose slot it is.
    pub track_id: Option<String>,
    /// Seen from a side that was never observed (paper presets only).
    pub beyond_coverage: bool,
}

impl<'a> Stage<'a> {
    /// From a background asset's header.
    ///
    /// # Errors
    /// [`Error::Invalid`] if the asset is not a background with recording and valid region.
    pub fn from_header(name: &str, header: &'a AssetHeader) -> Result<Self> {
        match (&header.recording, &header.valid_region) {
            (Some(recording), Some(region)) => Ok(Self {
                source_log: &header.source_log,
                recording,
                region,
            }),
            _ => Err(Error::invalid(format!(
                "{name} is not a background with a recording and a valid region"
            ))),
        }
    }
}

impl PlacedObject {
    pub fn occupied(&self) -> Occupied {
        Occupied {
            local_from_cuboid: self.local_from_object,
            size_m: self.size_m,
        }
    }
}

/// An original mover that a sample does not show.
#[derive(Clone, Debug, PartialEq)]
pub struct LeftOut {
    pub track_id: String,
    pub occupied: Occupied,
    /// Index into the library of its own asset, if it has one: its shape tells which pixels it hid.
    pub asset: Option<usize>,
}

/// What to render.
#[derive(Clone, Debug, PartialEq)]
pub struct Composition {
    /// Index into [`Recording::frames`].
    pub frame: usize,
    /// At the output size.
    pub camera: Camera,
    pub local_from_camera: Rigid,
    pub local_from_ego: Rigid,
    pub objects: Vec<PlacedObject>,
    /// Movers left out although the recorded image had them: what they hid was not seen at that time.
    pub left_out: Vec<LeftOut>,
    /// Rejected attempts by [`Rejection::name`].
    pub rejections: BTreeMap<String, u32>,
    pub insert_shadows: bool,
}

/// Attempts a slot: a crowded scene gives up here instead of searching forever.
pub const ATTEMPTS: u32 = 64;

/// Originals further from the camera than this are not labelled, metres.
const LABEL_RANGE_M: f64 = 100.0;

/// Composes sample `index` of a recipe. Bit-equal on every machine.
///
/// # Errors
/// [`Error::Invalid`] for a bad recipe, an unknown camera or frame, and when nothing can be drawn although objects are asked for.
pub fn compose(
    stage: &Stage<'_>,
    library: &[Candidate],
    recipe: &Recipe,
    seed: u64,
    index: u64,
) -> Result<Composition> {
    recipe.validate()?;
    let mut draws = Draws::new(seed, index, 0);
    let frames = eligible_frames(stage.recording, recipe)?;
    let frame = frames[draws.below(frames.len())];
    let requested = draws.between(recipe.min_objects, recipe.max_objects);
    let eligible = eligible_assets(library, recipe);
    if eligible.is_empty() && recipe.min_objects > 0 {
        return Err(Error::invalid(
            "recipe: no library object matches; train objects first or widen objects and classes",
        ));
    }
    let recorded = &stage.recording.frames[frame];
    let camera = stage
        .recording
        .camera(&recorded.camera_id)
        .ok_or_else(|| Error::invalid(format!("no camera \"{}\"", recorded.camera_id)))?;
    let mut composition = Composition {
        frame,
        camera: output_camera(camera, recipe.longer_side_px),
        local_from_camera: recorded.local_from_camera,
        local_from_ego: recorded.local_from_ego,
        objects: Vec::new(),
        left_out: Vec::new(),
        rejections: BTreeMap::new(),
        insert_shadows: recipe.insert_shadows,
    };
    let mut placer = Placer::new(*stage, library, eligible, recipe, &composition);
    place_originals(&mut composition, &mut placer, seed, index);
    for slot in 0..requested {
        let mut attempts = (0..ATTEMPTS).map(|a| Draws::new(seed, index, attempt(slot, a)));
        let placed = attempts.find_map(|mut draws| {
            placer
                .propose(&mut draws)
                .map_err(|reason| count(&mut composition.rejections, reason))
                .ok()
        });
        match placed {
            Some(object) => placer.accept(object, &mut composition.objects),
            None => count(&mut composition.rejections, Rejection::GaveUp),
        }
    }
    number(&mut composition.objects);
    Ok(composition)
}

/// Attempt 0 belongs to the sample itself; slots have disjoint ranges, so that none shifts another's draws.
fn attempt(slot: u32, attempt: u32) -> u32 {
    1 + slot * ATTEMPTS + attempt
}

/// Slots of replacements follow those of the inserts.
fn replacement_slot(track: usize) -> u32 {
    super::recipe::MAX_OBJECTS + track as u32
}

pub(super) fn count(rejections: &mut BTreeMap<String, u32>, reason: Rejection) {
    *rejections.entry(reason.name().to_owned()).or_default() += 1;
}

fn number(objects: &mut [PlacedObject]) {
    for (i, object) in objects.iter_mut().enumerate() {
        object.instance_id = u16::try_from(i + 1).unwrap_or(u16::MAX);
    }
}

fn eligible_frames(recording: &Recording, recipe: &Recipe) -> Result<Vec<usize>> {
    let camera_id = match (recipe.camera_id.as_str(), recording.cameras.first()) {
        ("", Some(first)) => first.camera_id.as_str(),
        (named, _) => named,
    };
    let frames: Vec<usize> = recording
        .frames
        .iter()
        .enumerate()
        .filter(|(_, f)| f.camera_id == camera_id)
        .filter(|(_, f)| {
            recipe.frame_indices.is_empty() || recipe.frame_indices.contains(&f.frame_index)
        })
        .map(|(i, _)| i)
        .collect();
    if frames.is_empty() {
        return Err(Error::invalid(format!(
            "recipe: the background has no frame of camera \"{camera_id}\" among those asked for"
        )));
    }
    Ok(frames)
}

fn eligible_assets(library: &[Candidate], recipe: &Recipe) -> Vec<usize> {
    (0..library.len())
        .filter(|i| {
            let asset = &library[*i];
            asset.library
                && (recipe.objects.is_empty() || recipe.objects.contains(&asset.name))
                && (recipe.classes.is_empty() || recipe.classes.contains(&asset.class))
        })
        .collect()
}

fn output_camera(camera: &Camera, longer_side_px: u32) -> Camera {
    if longer_side_px == 0 {
        return *camera;
    }
    let longer = f64::from(camera.width.max(camera.height));
    let scale = f64::from(longer_side_px) / longer;
    let side = |px: u32| (libm::round(f64::from(px) * scale) as u32).max(1);
    camera.resized(side(camera.width), side(camera.height))
}

/// Static originals are labelled where they stand; movers are replayed, shown as recorded, replaced or left out.
fn place_originals(composition: &mut Composition, placer: &mut Placer<'_>, seed: u64, index: u64) {
    let stage = placer.stage;
    let recipe = placer.recipe;
    for (i, track) in stage.recording.tracks.iter().enumerate() {
        let Some(pose) = pose_at(track, composition.frame) else {
            continue;
        };
        let original = Occupied {
            local_from_cuboid: pose,
            size_m: track.size_m,
        };
        placer.originals.push((i, original));
        if !in_image(composition, &original) {
            continue;
        }
        let mut object = PlacedObject {
            instance_id: 0,
            origin: Origin::Static,
            class: track.class,
            size_m: track.size_m,
            local_from_object: pose,
            asset: None,
            track_id: Some(track.track_id.clone()),
            beyond_coverage: false,
        };
        if !track.moving {
            composition.objects.push(object);
            continue;
        }
        object.origin = Origin::Replayed;
        object.asset = placer.library.iter().position(|asset| {
            asset.source_log == stage.source_log && asset.source_track_id == track.track_id
        });
        if recipe.drop_originals {
            composition.left_out.push(LeftOut {
                track_id: track.track_id.clone(),
                occupied: original,
                asset: object.asset,
            });
            placer.originals.pop();
            continue;
        }
        if object.asset.is_none() {
            object.origin = Origin::Recorded;
        }
        composition.objects.push(object);
    }
    replace_originals(composition, placer, seed, index);
}

/// After every original is known, so that a replacement is tested against all of them.
fn replace_originals(
    composition: &mut Composition,
    placer: &mut Placer<'_>,
    seed: u64,
    index: u64,
) {
    if placer.recipe.replace_probability == 0.0 {
        return;
    }
    let stage = placer.stage;
    for (i, track) in stage.recording.tracks.iter().enumerate() {
        let slot = replacement_slot(i);
        let Some(pose) = pose_at(track, composition.frame).filter(|_| track.moving) else {
            continue;
        };
        let original = Occupied {
            local_from_cuboid: pose,
            size_m: track.size_m,
        };
        let wanted =
            Draws::new(seed, index, attempt(slot, 0)).chance(placer.recipe.replace_probability);
        if !wanted || !in_image(composition, &original) {
            continue;
        }
        let placed = (1..ATTEMPTS).find_map(|a| {
            let mut draws = Draws::new(seed, index, attempt(slot, a));
            placer
                .replace(i, &original, &mut draws)
                .map_err(|reason| count(&mut composition.rejections, reason))
                .ok()
        });
        let Some(mut object) = placed else {
            count(&mut composition.rejections, Rejection::GaveUp);
            continue;
        };
        object.track_id = Some(track.track_id.clone());
        let is_original = |o: &PlacedObject| {
            o.track_id == object.track_id && matches!(o.origin, Origin::Replayed | Origin::Recorded)
        };
        if let Some(at) = composition.objects.iter().position(is_original) {
            let asset = composition.objects.remove(at).asset;
            composition.left_out.push(LeftOut {
                track_id: track.track_id.clone(),
                occupied: original,
                asset,
            });
        }
        placer.originals.retain(|(track, _)| *track != i);
        placer.accept(object, &mut composition.objects);
    }
}

/// A static object stands where it was last seen also in frames in which the log does not list it.
fn pose_at(track: &RecordedTrack, frame: usize) -> Option<Rigid> {
    let poses = &track.local_from_cuboid;
    if track.moving || poses[frame].is_some() {
        return poses[frame];
    }
    (0..poses.len())
        .filter(|i| poses[*i].is_some())
        .min_by_key(|i| i.abs_diff(frame))
        .and_then(|i| poses[i])
}

fn in_image(composition: &Composition, original: &Occupied) -> bool {
    let camera_from_cuboid = composition.local_from_camera.inverse() * original.local_from_cuboid;
    camera_from_cuboid.translation_m.length() < LABEL_RANGE_M
        && amodal_box(&composition.camera, &camera_from_cuboid, original.size_m)
            .and_then(|b| b.clipped(&composition.camera))
            .is_some()
}
