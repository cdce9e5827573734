//! Clips, edits of actors and given objects of a recipe as they arrive.

use backlot_engine::scene::{ActorEdit, Clip, Edit, GivenObject, Shift, Trajectory, Waypoint};
use backlot_proto::v1;

use super::convert_drive_log::{FieldReader, Place};
use crate::domain::ids::AssetId;

/// An absent clip is a single image.
pub(super) fn clip(fields: &mut FieldReader, wire: Option<v1::Clip>) -> Clip {
    let Some(wire) = wire else {
        return Clip::default();
    };
    let place = Place::new("recipe.clip");
    Clip {
        frames: wire.frame_count,
        stride: wire.stride.max(1),
        speed_mps: [
            fields.finite(&place.field("min_speed_mps"), wire.min_speed_mps),
            fields.finite(&place.field("max_speed_mps"), wire.max_speed_mps),
        ],
    }
}

pub(super) fn edits(fields: &mut FieldReader, wire: Vec<v1::ActorEdit>) -> Vec<ActorEdit> {
    let read = wire.into_iter().enumerate().filter_map(|(i, edit)| {
        let place = Place::new(format!("recipe.edits[{i}]"));
        if edit.track_id.is_empty() {
            fields.reject(&place.field("track_id"), "is missing");
        }
        let read = match fields.required(&place.field("edit"), edit.edit)? {
            v1::actor_edit::Edit::Remove(_) => Edit::Remove,
            v1::actor_edit::Edit::Shift(shift) => {
                let place = place.field("shift");
                Edit::Shift(Shift {
                    x_m: fields.finite(&place.field("x_m"), shift.x_m),
                    y_m: fields.finite(&place.field("y_m"), shift.y_m),
                    heading_rad: fields.finite(&place.field("heading_rad"), shift.heading_rad),
                })
            }
            v1::actor_edit::Edit::Follow(path) => {
                Edit::Follow(trajectory(fields, &place.field("follow"), path))
            }
        };
        Some(ActorEdit {
            track_id: edit.track_id,
            edit: read,
        })
    });
    read.collect()
}

/// Trajectories in the frame they arrive in.
pub(super) fn given_objects(
    fields: &mut FieldReader,
    wire: Vec<v1::GivenObject>,
) -> Vec<GivenObject> {
    let read = wire.into_iter().enumerate().filter_map(|(i, given)| {
        let place = Place::new(format!("recipe.given_objects[{i}]"));
        if let Err(error) = given.asset.parse::<AssetId>() {
            fields.reject(&place.field("asset"), &error.to_string());
        }
        let place = place.field("trajectory");
        let path = fields.required(&place, given.trajectory)?;
        Some(GivenObject {
            asset: given.asset,
            trajectory: trajectory(fields, &place, path),
        })
    });
    read.collect()
}

fn trajectory(fields: &mut FieldReader, place: &Place, wire: v1::Trajectory) -> Trajectory {
    let waypoints = wire.waypoints.into_iter().enumerate().map(|(i, point)| {
        let place = place.field(&format!("waypoints[{i}]"));
        Waypoint {
            time_s: fields.finite(&place.field("time_s"), point.time_s),
            position_m: fields.vector(&place.field("position_m"), point.position_m),
            heading_rad: fields.finite(&place.field("heading_rad"), point.heading_rad),
        }
    });
    Trajectory {
        waypoints: waypoints.collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wrong_edits_are_named() {
        let mut fields = FieldReader::default();
        let nothing = v1::ActorEdit {
            track_id: "7".into(),
            edit: None,
        };
        let shift = v1::ActorEdit {
            track_id: "8".into(),
            edit: Some(v1::actor_edit::Edit::Shift(v1::ShiftActor {
                y_m: f64::NAN,
                ..Default::default()
            })),
        };
        let read = edits(&mut fields, vec![nothing, shift]);
        assert_eq!(read.len(), 1);
        let given = v1::GivenObject {
            asset: "car".into(),
            trajectory: Some(v1::Trajectory {
                waypoints: vec![v1::Waypoint::default()],
            }),
        };
        given_objects(&mut fields, vec![given]);
        let said = fields.violations.into_result(()).unwrap_err().to_string();
        for field in [
            "recipe.edits[0].edit",
            "recipe.edits[1].shift.y_m: is NaN",
            "recipe.given_objects[0].asset",
            "recipe.given_objects[0].trajectory.waypoints[0].position_m",
        ] {
            assert!(said.contains(field), "{field} in {said}");
        }
    }

    #[test]
    fn a_clip_without_a_stride_takes_every_frame() {
        let mut fields = FieldReader::default();
        let wire = v1::Clip {
            frame_count: 8,
            max_speed_mps: 12.0,
            ..Default::default()
        };
        let read = clip(&mut fields, Some(wire));
        assert_eq!((read.frames, read.stride), (8, 1));
        assert_eq!(read.speed_mps, [0.0, 12.0]);
        assert_eq!(clip(&mut fields, None), Clip::default());
    }
}
