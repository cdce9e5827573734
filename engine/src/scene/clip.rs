//! Samples of several frames: the same objects through a stretch of the recording.

use std::collections::BTreeMap;

use super::composition::{Candidate, Composition, PlacedObject, Stage, compose_first};
use super::movement::ClipSpace;
use super::originals::{in_image, show_original};
use super::placement::beyond_coverage;
use super::recipe::Recipe;
use crate::Result;

/// Composes every frame of sample `index` of a recipe, in the order of time. Bit-equal on every machine.
///
/// An object keeps its instance id through all frames. The first frame is [`super::compose`]'s and carries the rejections of the whole
/// clip: an object is placed only if it stands on free ground and touches nothing at any tested time of it.
///
/// # Errors
/// As [`super::compose`].
pub fn compose_clip(
    stage: &Stage<'_>,
    library: &[Candidate],
    recipe: &Recipe,
    seed: u64,
    index: u64,
) -> Result<Vec<Composition>> {
    let (first, clip) = compose_first(stage, library, recipe, seed, index)?;
    let mut names = Names::of_first(&first.objects);
    let mut frames = vec![first];
    for k in 1..clip.frames.len() {
        let mut later = later_frame(&frames[0], stage, library, recipe, &clip, k);
        names.number(&mut later.objects);
        frames.push(later);
    }
    Ok(frames)
}

fn later_frame(
    first: &Composition,
    stage: &Stage<'_>,
    library: &[Candidate],
    recipe: &Recipe,
    clip: &ClipSpace<'_>,
    k: usize,
) -> Composition {
    let frame = clip.frames[k];
    let recorded = &stage.recording.frames[frame];
    let mut later = Composition {
        frame,
        camera: first.camera,
        local_from_camera: recorded.local_from_camera,
        local_from_ego: recorded.local_from_ego,
        objects: Vec::new(),
        left_out: Vec::new(),
        rejections: BTreeMap::new(),
        insert_shadows: first.insert_shadows,
        daylight: first.daylight,
    };
    for track in 0..stage.recording.tracks.len() {
        show_original(&mut later, stage, library, &clip.absent, track);
    }
    for movement in &clip.movements {
        let Some(mut object) = clip.at_frame(movement, k) else {
            continue;
        };
        object.beyond_coverage = in_image(&later, &object.occupied())
            && beyond_coverage(library, recipe, recorded, &object);
        later.objects.push(object);
    }
    later
}

/// Which objects of a clip are the same: originals by their track; placed ones already carry the id of the first frame.
struct Names {
    tracks: BTreeMap<String, u16>,
    used: u16,
}

impl Names {
    fn of_first(objects: &[PlacedObject]) -> Self {
        let originals = objects.iter().filter(|o| o.origin.is_as_recorded());
        let named = originals.filter_map(|o| Some((o.track_id.clone()?, o.instance_id)));
        Self {
            tracks: named.collect(),
            used: objects.iter().map(|o| o.instance_id).max().unwrap_or(0),
        }
    }

    fn number(&mut self, objects: &mut [PlacedObject]) {
        for object in objects.iter_mut().filter(|o| o.origin.is_as_recorded()) {
            let track = object.track_id.clone().unwrap_or_default();
            object.instance_id = *self.tracks.entry(track).or_insert_with(|| {
                self.used = self.used.saturating_add(1);
                self.used
            });
        }
    }
}
