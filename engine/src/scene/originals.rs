//! The log's own objects in a composition: labelled, replayed, left out, replaced or moved.

use glam::DVec3;

use super::collision::Occupied;
use super::composition::{
    ATTEMPTS, Candidate, Composition, LeftOut, Origin, PlacedObject, Stage, accept, attempt, count,
    refuse, replacement_slot,
};
use super::edit::{Edit, ResolvedEdit, own_asset};
use super::movement::{ClipSpace, Course};
use super::placement::Placer;
use super::projection::amodal_box;
use super::random::Draws;
use super::recording::RecordedTrack;
use super::rejection::Rejection;
use super::timeline::recorded_velocity;
use crate::camera::Rigid;

/// Originals further from the camera than this are not labelled, metres.
const LABEL_RANGE_M: f64 = 100.0;

/// Static originals are labelled where they stand; movers are replayed, shown as recorded, or left out.
pub(super) fn place_originals(
    composition: &mut Composition,
    placer: &mut Placer<'_>,
    clip: &mut ClipSpace<'_>,
    edits: &[ResolvedEdit<'_>],
) {
    let stage = placer.stage;
    let removed = edits.iter().filter(|e| *e.edit == Edit::Remove);
    clip.absent.extend(removed.map(|e| e.track));
    if placer.recipe.drop_originals {
        let tracks = stage.recording.tracks.iter().enumerate();
        clip.absent
            .extend(tracks.filter(|(_, t)| t.moving).map(|(i, _)| i));
    }
    for (i, track) in stage.recording.tracks.iter().enumerate() {
        let Some(local_from_cuboid) = pose_at(track, composition.frame) else {
            continue;
        };
        if !clip.absent.contains(&i) {
            let original = Occupied {
                local_from_cuboid,
                size_m: track.size_m,
            };
            placer.originals.push((i, original));
        }
        show_original(composition, &stage, placer.library, &clip.absent, i);
    }
}

/// Adds a track as the composition's frame shows it, or to what it leaves out; nothing if it is not in the image.
pub(super) fn show_original(
    composition: &mut Composition,
    stage: &Stage<'_>,
    library: &[Candidate],
    absent: &[usize],
    index: usize,
) {
    let track = &stage.recording.tracks[index];
    let Some(pose) = pose_at(track, composition.frame) else {
        return;
    };
    let occupied = Occupied {
        local_from_cuboid: pose,
        size_m: track.size_m,
    };
    if occupied.contains(composition.local_from_camera.translation_m) {
        count(&mut composition.rejections, Rejection::CameraInside);
        return;
    }
    if !in_image(composition, &occupied) {
        return;
    }
    let asset = match track.moving {
        true => own_asset(stage, library, &track.track_id),
        false => None,
    };
    if absent.contains(&index) {
        composition.left_out.push(LeftOut {
            track_id: track.track_id.clone(),
            occupied,
            asset,
        });
        return;
    }
    let origin = match (track.moving, asset) {
        (false, _) => Origin::Static,
        (true, Some(_)) => Origin::Replayed,
        (true, None) => Origin::Recorded,
    };
    composition.objects.push(PlacedObject {
        instance_id: 0,
        origin,
        class: track.class,
        size_m: track.size_m,
        local_from_object: pose,
        asset,
        track_id: Some(track.track_id.clone()),
        beyond_coverage: false,
        velocity_mps: recorded_velocity(stage.recording, track, composition.frame),
    });
}

/// After every original is known, so that a replacement is tested against all of them.
pub(super) fn replace_originals(
    composition: &mut Composition,
    placer: &mut Placer<'_>,
    clip: &mut ClipSpace<'_>,
    assets: &[usize],
    [seed, index]: [u64; 2],
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
        if placer
            .recipe
            .edits
            .iter()
            .any(|e| e.track_id == track.track_id)
        {
            continue;
        }
        let original = Occupied {
            local_from_cuboid: pose,
            size_m: track.size_m,
        };
        let wanted =
            Draws::new(seed, index, attempt(slot, 0)).chance(placer.recipe.replace_probability);
        let inside = original.contains(composition.local_from_camera.translation_m);
        if !wanted || inside || !in_image(composition, &original) {
            continue;
        }
        let placed = (1..ATTEMPTS).find_map(|a| {
            let mut draws = Draws::new(seed, index, attempt(slot, a));
            let driven = placer
                .replace(assets, i, &original, &mut draws)
                .and_then(|mut object| {
                    object.track_id = Some(track.track_id.clone());
                    let track_from_object = pose.inverse() * object.local_from_object;
                    let course = Course::Slot {
                        track: i,
                        track_from_object,
                    };
                    clip.drive(object, course)
                });
            driven
                .map_err(|reason| count(&mut composition.rejections, reason))
                .ok()
        });
        let Some(movement) = placed else {
            count(&mut composition.rejections, Rejection::GaveUp);
            continue;
        };
        vacate(composition, placer, clip, i);
        accept(composition, placer, clip, movement);
    }
}

/// Leaves an original out of the sample.
fn vacate(
    composition: &mut Composition,
    placer: &mut Placer<'_>,
    clip: &mut ClipSpace<'_>,
    index: usize,
) {
    let track = &placer.stage.recording.tracks[index];
    let is_original = |o: &PlacedObject| {
        o.track_id.as_ref() == Some(&track.track_id)
            && matches!(o.origin, Origin::Replayed | Origin::Recorded)
    };
    if let Some(at) = composition.objects.iter().position(is_original) {
        let original = composition.objects.remove(at);
        composition.left_out.push(LeftOut {
            track_id: track.track_id.clone(),
            occupied: original.occupied(),
            asset: original.asset,
        });
    }
    placer.originals.retain(|(track, _)| *track != index);
    clip.absent.push(index);
}

/// Moves originals as the recipe says; one that cannot stand where it should stays as recorded.
pub(super) fn move_originals(
    composition: &mut Composition,
    placer: &mut Placer<'_>,
    clip: &mut ClipSpace<'_>,
    edits: &[ResolvedEdit<'_>],
) {
    for edit in edits {
        let Some(asset) = edit.asset else { continue };
        let track = &placer.stage.recording.tracks[edit.track];
        let recorded = pose_at(track, composition.frame);
        if recorded.is_none() && matches!(edit.edit, Edit::Shift(_)) {
            continue;
        }
        let mut object = placer.posed(asset, Rigid::IDENTITY, Origin::Moved);
        object.track_id = Some(track.track_id.clone());
        let still = match edit.edit {
            // Of a single image the track's own velocity is all that is known of a shifted actor.
            Edit::Shift(_) => clip.velocity_of(edit.track, composition.frame),
            Edit::Follow(_) | Edit::Remove => Some(DVec3::ZERO),
        };
        let moved = clip.along(object, Some(edit.track), still, |instant| match edit.edit {
            Edit::Shift(shift) => {
                let pose = instant.pose(|frame| track.local_from_cuboid[frame])?;
                Some(shift.of(&pose))
            }
            Edit::Follow(path) => Some(path.at(instant.time_s)),
            Edit::Remove => None,
        });
        let tested = moved.and_then(|movement| placer.test_given(movement, Some(edit.track)));
        match tested {
            Ok(movement) => {
                vacate(composition, placer, clip, edit.track);
                accept(composition, placer, clip, movement);
            }
            Err(reason) => refuse(composition, reason),
        }
    }
}

/// A static object stands where it was last seen also in frames in which the log does not list it.
pub(super) fn pose_at(track: &RecordedTrack, frame: usize) -> Option<Rigid> {
    let poses = &track.local_from_cuboid;
    if track.moving || poses[frame].is_some() {
        return poses[frame];
    }
    (0..poses.len())
        .filter(|i| poses[*i].is_some())
        .min_by_key(|i| i.abs_diff(frame))
        .and_then(|i| poses[i])
}

pub(super) fn in_image(composition: &Composition, original: &Occupied) -> bool {
    let camera_from_cuboid = composition.local_from_camera.inverse() * original.local_from_cuboid;
    camera_from_cuboid.translation_m.length() < LABEL_RANGE_M
        && amodal_box(&composition.camera, &camera_from_cuboid, original.size_m)
            .and_then(|b| b.clipped(&composition.camera))
            .is_some()
}
