//! Annotations of a log.

use std::path::Path;

use backlot_proto::v1::{ObjectClass, Occlusion, Track};
use glam::DVec3;

use super::feather::Columns;
use super::poses::{POSE_COLUMNS, rigids};
use crate::read_log::Result;
use crate::read_log::observations::{self, Observation};
use crate::read_log::trajectory::Trajectory;

/// Reads the tracks; boxes are in the ego frame of the sweep they annotate.
pub(super) fn read(
    log_dir: &Path,
    trajectory: &Trajectory,
    notes: &mut Vec<String>,
) -> Result<Vec<Track>> {
    let path = log_dir.join("annotations.feather");
    if !path.exists() {
        notes.push("no annotations: nothing tells movers from the background".to_owned());
        return Ok(Vec::new());
    }
    let others = [
        "timestamp_ns",
        "track_uuid",
        "category",
        "length_m",
        "width_m",
        "height_m",
    ];
    let wanted: Vec<&str> = POSE_COLUMNS.into_iter().chain(others).collect();
    let columns = Columns::read(&path, &wanted, "")?;
    let times = columns.integers("timestamp_ns")?;
    let mut ids = columns.texts("track_uuid")?.into_iter();
    let mut categories = columns.texts("category")?.into_iter();
    let [length, width] = [columns.numbers("length_m")?, columns.numbers("width_m")?];
    let height = columns.numbers("height_m")?;
    let mut observed = Vec::with_capacity(times.len());
    for (i, ego_from_cuboid) in rigids(&columns)?.into_iter().enumerate() {
        let (Some(track_id), Some(category)) = (ids.next(), categories.next()) else {
            return Err(columns.bad_row(i, "has no track or category"));
        };
        if times[i] < 0 {
            return Err(columns.bad_row(i, format!("{} is no time in nanoseconds", times[i])));
        }
        observed.push(Observation {
            track_id,
            object_class: object_class(&category),
            source_class: category,
            size_m: DVec3::new(length[i], width[i], height[i]),
            timestamp_ns: times[i],
            world_from_cuboid: trajectory.at(times[i]) * ego_from_cuboid,
            occlusion: Occlusion::Unspecified,
        });
    }
    observations::tracks(&path, observed, notes)
}

fn object_class(category: &str) -> ObjectClass {
    match category {
        "REGULAR_VEHICLE" => ObjectClass::Car,
        "LARGE_VEHICLE" | "BOX_TRUCK" | "TRUCK" | "TRUCK_CAB" => ObjectClass::Truck,
        "BUS" | "SCHOOL_BUS" | "ARTICULATED_BUS" => ObjectClass::Bus,
        "RAILED_VEHICLE" => ObjectClass::Tram,
        "PEDESTRIAN" | "OFFICIAL_SIGNALER" => ObjectClass::Pedestrian,
        "BICYCLIST" | "MOTORCYCLIST" | "WHEELED_RIDER" => ObjectClass::Cyclist,
        _ => ObjectClass::Other,
    }
}
