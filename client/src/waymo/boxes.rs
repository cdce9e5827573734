//! Labelled boxes of a segment.

use std::collections::BTreeMap;
use std::path::Path;

use backlot_engine::camera::Rigid;
use backlot_proto::v1::{ObjectClass, Occlusion, Track};
use glam::DVec3;

use super::cameras::FRAME_TIME;
use super::table::Table;
use crate::read_log::Result;
use crate::read_log::content::{position, time_of_micros};
use crate::read_log::observations::{self, Observation};

const TRACK: &str = "key.laser_object_id";
const CENTRE: [&str; 3] = [
    "[LiDARBoxComponent].box.center.x",
    "[LiDARBoxComponent].box.center.y",
    "[LiDARBoxComponent].box.center.z",
];
const SIZE: [&str; 3] = [
    "[LiDARBoxComponent].box.size.x",
    "[LiDARBoxComponent].box.size.y",
    "[LiDARBoxComponent].box.size.z",
];
const HEADING: &str = "[LiDARBoxComponent].box.heading";
const TYPE: &str = "[LiDARBoxComponent].type";

/// Reads the tracks; boxes are upright in the vehicle frame of their frame.
pub(super) fn read(
    root: &Path,
    segment: &str,
    world_from_vehicle: &BTreeMap<i64, Rigid>,
    notes: &mut Vec<String>,
) -> Result<Vec<Track>> {
    let Some(table) = Table::open(root, "lidar_box", segment)? else {
        notes.push("no lidar_box: nothing tells movers from the background".to_owned());
        return Ok(Vec::new());
    };
    let mut names = vec![FRAME_TIME, TRACK, HEADING, TYPE];
    names.extend(CENTRE.iter().chain(&SIZE));
    let mut rows = table.rows(&names, &[])?;
    let mut observed = Vec::new();
    while let Some(row) = rows.next_row()? {
        let three = |names: [&str; 3]| -> Result<[f64; 3]> {
            Ok([
                row.number(names[0])?,
                row.number(names[1])?,
                row.number(names[2])?,
            ])
        };
        let timestamp_ns = time_of_micros(row.integer(FRAME_TIME)?).map_err(|e| row.bad(e))?;
        let pose = world_from_vehicle.get(&timestamp_ns);
        let pose = pose.ok_or_else(|| row.bad(format!("no vehicle_pose at {timestamp_ns} ns")))?;
        let heading = row.number(HEADING)?;
        let centre = position(three(CENTRE)?).map_err(|e| row.bad(e))?;
        if !heading.is_finite() {
            return Err(row.bad(format!("heading is {heading}")));
        }
        let (source_class, object_class) = class(row.integer(TYPE)?);
        observed.push(Observation {
            track_id: row.text(TRACK)?,
            source_class: source_class.to_owned(),
            object_class,
            size_m: DVec3::from_array(three(SIZE)?),
            timestamp_ns,
            world_from_cuboid: *pose * Rigid::from_heading(heading, centre),
            occlusion: Occlusion::Unspecified,
        });
    }
    observations::tracks(table.path(), observed, notes)
}

fn class(number: i64) -> (&'static str, ObjectClass) {
    match number {
        1 => ("VEHICLE", ObjectClass::Car),
        2 => ("PEDESTRIAN", ObjectClass::Pedestrian),
        3 => ("SIGN", ObjectClass::Other),
        4 => ("CYCLIST", ObjectClass::Cyclist),
        _ => ("UNKNOWN", ObjectClass::Other),
    }
}
