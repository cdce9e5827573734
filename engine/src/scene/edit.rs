//! Changes that a recipe makes to the log's own movers, and objects whose poses it gives.

use glam::{DVec2, DVec3};
use serde::{Deserialize, Serialize};

use super::arcs::wrap;
use super::composition::{Candidate, Stage};
use super::trajectory::Trajectory;
use crate::camera::Rigid;
use crate::{Error, Result};

/// What becomes of an original mover.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Edit {
    /// It is left out; what it hid is filled and marked.
    Remove,
    /// Its own asset drives beside its recorded path, moved in the mover's frame (x forward, y left) and turned about the ground's normal.
    Shift(Shift),
    /// Its own asset drives another path.
    Follow(Trajectory),
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Shift {
    pub x_m: f64,
    pub y_m: f64,
    pub heading_rad: f64,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ActorEdit {
    /// The log's track.
    pub track_id: String,
    pub edit: Edit,
}

/// An object that stands or drives where the recipe says.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct GivenObject {
    /// Asset name.
    pub asset: String,
    pub trajectory: Trajectory,
}

pub const MAX_EDITS: usize = 64;
pub const MAX_GIVEN_OBJECTS: usize = 32;
/// Further is another street.
const MAX_SHIFT_M: f64 = 200.0;

impl Shift {
    /// Position and heading of a mover whose recorded pose is given.
    pub(super) fn of(&self, recorded: &Rigid) -> (DVec2, f64) {
        let at = recorded.point(DVec3::new(self.x_m, self.y_m, 0.0));
        let heading = wrap(recorded.heading_rad() + self.heading_rad);
        (at.truncate(), heading)
    }
}

/// Checks edits and given objects by themselves.
///
/// # Errors
/// [`Error::Invalid`] naming the field.
pub(super) fn validate(edits: &[ActorEdit], given: &[GivenObject]) -> Result<()> {
    if edits.len() > MAX_EDITS {
        let count = edits.len();
        return Err(Error::invalid(format!(
            "recipe: {count} edits, at most {MAX_EDITS}"
        )));
    }
    if given.len() > MAX_GIVEN_OBJECTS {
        let count = given.len();
        return Err(Error::invalid(format!(
            "recipe: {count} given_objects, at most {MAX_GIVEN_OBJECTS}"
        )));
    }
    for (i, edit) in edits.iter().enumerate() {
        let track = &edit.track_id;
        if edits[..i].iter().any(|e| e.track_id == *track) {
            return Err(Error::invalid(format!(
                "recipe: edits[{i}]: track \"{track}\" is edited twice"
            )));
        }
        match &edit.edit {
            Edit::Remove => {}
            Edit::Follow(path) => path.validate(&format!("recipe: edits[{i}].follow"))?,
            Edit::Shift(shift) => {
                let far = |v: f64| !(-MAX_SHIFT_M..=MAX_SHIFT_M).contains(&v);
                if far(shift.x_m) || far(shift.y_m) || !shift.heading_rad.is_finite() {
                    return Err(Error::invalid(format!(
                        "recipe: edits[{i}].shift must be finite and within {MAX_SHIFT_M} m"
                    )));
                }
            }
        }
    }
    for (i, object) in given.iter().enumerate() {
        let field = format!("recipe: given_objects[{i}].trajectory");
        object.trajectory.validate(&field)?;
    }
    Ok(())
}

/// An edit with the track and, if it is moved, the asset that it names.
#[derive(Clone, Copy, Debug)]
pub(super) struct ResolvedEdit<'a> {
    pub(super) track: usize,
    /// `None` for a removal.
    pub(super) asset: Option<usize>,
    pub(super) edit: &'a Edit,
}

/// Looks the edited tracks and their assets up.
///
/// # Errors
/// [`Error::Invalid`] for unknown tracks, tracks that are part of the background, and moved tracks without an asset.
pub(super) fn resolve<'a>(
    stage: &Stage<'_>,
    library: &[Candidate],
    edits: &'a [ActorEdit],
) -> Result<Vec<ResolvedEdit<'a>>> {
    let resolved = edits.iter().enumerate().map(|(i, edit)| {
        let id = &edit.track_id;
        let refuse = |why: &str| Err(Error::invalid(format!("recipe: edits[{i}]: {why}")));
        let tracks = &stage.recording.tracks;
        let Some(track) = tracks.iter().position(|t| t.track_id == *id) else {
            return refuse(&format!("the log has no track \"{id}\""));
        };
        if !tracks[track].moving {
            return refuse(&format!(
                "track \"{id}\" never moves: it is part of the background and can be neither removed nor moved"
            ));
        }
        let asset = own_asset(stage, library, id);
        match (&edit.edit, asset) {
            (Edit::Remove, _) => Ok(ResolvedEdit {
                track,
                asset: None,
                edit: &edit.edit,
            }),
            (_, None) => refuse(&format!(
                "track \"{id}\" has no asset to move; train objects of the log"
            )),
            (_, asset) => Ok(ResolvedEdit {
                track,
                asset,
                edit: &edit.edit,
            }),
        }
    });
    resolved.collect()
}

/// The library's asset that was trained from a track of the stage's log.
pub(super) fn own_asset(stage: &Stage<'_>, library: &[Candidate], track_id: &str) -> Option<usize> {
    library
        .iter()
        .position(|a| a.source_log == stage.source_log && a.source_track_id == track_id)
}

/// Library indices of the given objects, in their order.
///
/// # Errors
/// [`Error::Invalid`] for an asset that the library lacks.
pub(super) fn resolve_given(library: &[Candidate], given: &[GivenObject]) -> Result<Vec<usize>> {
    let found = given.iter().enumerate().map(|(i, object)| {
        let asset = library.iter().position(|a| a.name == object.asset);
        asset.ok_or_else(|| {
            Error::invalid(format!(
                "recipe: given_objects[{i}]: the library has no object \"{}\"",
                object.asset
            ))
        })
    });
    found.collect()
}
