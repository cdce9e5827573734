//! Chooses a recorded pose and what stands in the scene: a pure function of (stage, library, recipe, seed, index).

use std::collections::BTreeMap;

use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::collision::Occupied;
use super::daylight::Daylight;
use super::edit::{resolve, resolve_given};
use super::movement::{ClipSpace, Course, Movement};
use super::originals::{move_originals, place_originals, replace_originals};
use super::placement::Placer;
use super::random::Draws;
use super::recipe::Recipe;
use super::recording::Recording;
use super::rejection::Rejection;
use super::target::Targets;
use super::timeline::Instant;
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
    /// An original mover, rendered from its own asset where the recipe puts it.
    Moved,
}

impl Origin {
    /// Whether the object is where the log recorded it.
    pub fn is_as_recorded(self) -> bool {
        matches!(self, Self::Replayed | Self::Recorded | Self::Static)
    }
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
    /// Seen from a side that was never observed (paper presets, given poses, and slots in later frames of clips only).
    pub beyond_coverage: bool,
    /// In the local frame; `None` where the log does not tell.
    pub velocity_mps: Option<DVec3>,
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
    /// The sunlight, as far as it is known.
    pub daylight: Option<Daylight>,
}

/// Attempts a slot: a crowded scene gives up here instead of searching forever.
pub const ATTEMPTS: u32 = 64;

/// Slots draw what they are to be from streams of their own, beyond all attempts.
const TARGETS: u32 = 1 << 30;

/// Composes the first frame of sample `index` of a recipe, the only one unless the recipe asks for a clip. Bit-equal on every machine.
///
/// # Errors
/// [`Error::Invalid`] for a bad recipe, an unknown camera, frame, track or asset, and when nothing can be drawn although objects are
/// asked for.
pub fn compose(
    stage: &Stage<'_>,
    library: &[Candidate],
    recipe: &Recipe,
    seed: u64,
    index: u64,
) -> Result<Composition> {
    compose_first(stage, library, recipe, seed, index).map(|(first, _)| first)
}

/// The first frame, and where everything is in the later ones.
pub(super) fn compose_first<'a>(
    stage: &Stage<'a>,
    library: &[Candidate],
    recipe: &Recipe,
    seed: u64,
    index: u64,
) -> Result<(Composition, ClipSpace<'a>)> {
    recipe.validate()?;
    let edits = resolve(stage, library, &recipe.edits)?;
    let given = resolve_given(library, &recipe.given_objects)?;
    let targets = Targets::new(stage, library, recipe)?;
    let mut draws = Draws::new(seed, index, 0);
    let frames = eligible_frames(stage.recording, recipe)?;
    let frame = frames[draws.below(frames.len())];
    let requested = draws.between(recipe.min_objects, recipe.max_objects);
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
        daylight: stage.recording.light(),
    };
    let frames = recipe.clip.frames_from(stage.recording, frame);
    let mut clip = ClipSpace::new(*stage, frames.expect("only such frames are eligible"));
    let mut placer = Placer::new(*stage, library, recipe, &composition);
    place_originals(&mut composition, &mut placer, &mut clip, &edits);
    let assets = targets.assets();
    replace_originals(
        &mut composition,
        &mut placer,
        &mut clip,
        &assets,
        [seed, index],
    );
    move_originals(&mut composition, &mut placer, &mut clip, &edits);
    place_given(&mut composition, &mut placer, &mut clip, &given);
    if requested > 0 {
        placer.find_places();
    }
    let [slow, fast] = recipe.clip.speed_mps;
    for slot in 0..requested {
        let Some(target) = targets.draw(&mut Draws::new(seed, index, TARGETS + slot)) else {
            count(&mut composition.rejections, Rejection::NoAsset);
            continue;
        };
        let mut attempts = (0..ATTEMPTS).map(|a| Draws::new(seed, index, attempt(slot, a)));
        let placed = attempts.find_map(|mut draws| {
            let driven = placer.propose(&target, &mut draws).and_then(|object| {
                let speed_mps = draws.uniform(slow, fast);
                let movement = clip.drive(object, Course::Straight { speed_mps })?;
                placer.test_later_views(movement, &clip)
            });
            driven
                .map_err(|reason| count(&mut composition.rejections, reason))
                .ok()
        });
        match placed {
            Some(movement) => accept(&mut composition, &mut placer, &mut clip, movement),
            None => count(&mut composition.rejections, Rejection::GaveUp),
        }
    }
    number(&mut composition.objects);
    clip.name(&composition.objects);
    Ok((composition, clip))
}

pub(super) fn accept(
    composition: &mut Composition,
    placer: &mut Placer<'_>,
    clip: &mut ClipSpace<'_>,
    movement: Movement,
) {
    placer.accept(movement.object.clone(), &mut composition.objects);
    clip.accept(movement);
}

/// Attempt 0 belongs to the sample itself; slots have disjoint ranges, so that none shifts another's draws.
pub(super) fn attempt(slot: u32, attempt: u32) -> u32 {
    1 + slot * ATTEMPTS + attempt
}

/// Slots of replacements follow those of the inserts.
pub(super) fn replacement_slot(track: usize) -> u32 {
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
    let starts = |first: &usize| recipe.clip.frames_from(recording, *first).is_some();
    let frames: Vec<usize> = frames.into_iter().filter(starts).collect();
    if frames.is_empty() {
        return Err(Error::invalid(format!(
            "recipe: clip: camera \"{camera_id}\" has no {} frames, {} apart and within two minutes, from any of the frames asked for",
            recipe.clip.frames, recipe.clip.stride
        )));
    }
    Ok(frames)
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

/// Places the objects whose poses the recipe gives.
fn place_given(
    composition: &mut Composition,
    placer: &mut Placer<'_>,
    clip: &mut ClipSpace<'_>,
    assets: &[usize],
) {
    let recipe = placer.recipe;
    for (given, asset) in recipe.given_objects.iter().zip(assets) {
        let object = placer.posed(*asset, Rigid::IDENTITY, Origin::Inserted);
        let path = |instant: &Instant| Some(given.trajectory.at(instant.time_s));
        let driven = clip.along(object, None, Some(DVec3::ZERO), path);
        match driven.and_then(|movement| placer.test_given(movement, None)) {
            Ok(movement) => accept(composition, placer, clip, movement),
            Err(reason) => refuse(composition, reason),
        }
    }
}

pub(super) fn refuse(composition: &mut Composition, reason: Rejection) {
    count(&mut composition.rejections, reason);
    count(&mut composition.rejections, Rejection::GivenRefused);
}
