//! Annotations of a scene.

use std::collections::{BTreeMap, BTreeSet};

use backlot_proto::v1::{ObjectClass, Occlusion, Track};
use glam::DVec3;

use super::scene::Scene;
use super::tables::{AnnotationRow, CategoryRow, InstanceRow, Tables, VisibilityRow};
use crate::read_log::Result;
use crate::read_log::content::rigid;
use crate::read_log::observations::{self, Observation};

/// Reads the tracks of a scene: an instance is a track, with a state at each keyframe that annotates it.
pub(super) fn read(tables: &Tables, scene: &Scene, notes: &mut Vec<String>) -> Result<Vec<Track>> {
    let annotated: Vec<AnnotationRow> = tables
        .rows("sample_annotation", |row: &AnnotationRow| {
            scene.samples.contains_key(&row.sample_token)
        })?;
    if annotated.is_empty() {
        notes.push("no annotations: nothing tells movers from the background".to_owned());
        return Ok(Vec::new());
    }
    let classes = read_classes(tables, &annotated)?;
    let visibility: Vec<VisibilityRow> = tables.rows("visibility", |_| true)?;
    let path = tables.path("sample_annotation");
    let mut observed = Vec::with_capacity(annotated.len());
    for row in annotated {
        let source_class = classes[&row.instance_token].clone();
        let level = visibility.iter().find(|v| v.token == row.visibility_token);
        let [width, length, height] = row.size;
        let pose = rigid(row.rotation, row.translation).map_err(|what| {
            let what = format!("a box of {}: {what}", row.instance_token);
            crate::read_log::Error::malformed(&path, what)
        })?;
        observed.push(Observation {
            object_class: object_class(&source_class),
            source_class,
            size_m: DVec3::new(length, width, height),
            timestamp_ns: scene.samples[&row.sample_token],
            world_from_cuboid: pose,
            occlusion: level.map_or(Occlusion::Unspecified, |v| occlusion(&v.level)),
            track_id: row.instance_token,
        });
    }
    observations::tracks(&path, observed, notes)
}

/// Category names by instance.
fn read_classes(tables: &Tables, annotated: &[AnnotationRow]) -> Result<BTreeMap<String, String>> {
    let wanted: BTreeSet<&str> = annotated
        .iter()
        .map(|r| r.instance_token.as_str())
        .collect();
    let categories: Vec<CategoryRow> = tables.rows("category", |_| true)?;
    let instances = tables.rows("instance", |row: &InstanceRow| {
        wanted.contains(row.token.as_str())
    })?;
    let mut classes = BTreeMap::new();
    for instance in instances {
        let token = &instance.category_token;
        let category = categories
            .iter()
            .find(|category| category.token == *token)
            .ok_or_else(|| tables.no_row("category", token, "instance.json"))?;
        classes.insert(instance.token, category.name.clone());
    }
    match wanted.iter().find(|token| !classes.contains_key(**token)) {
        Some(token) => Err(tables.no_row("instance", token, "sample_annotation.json")),
        None => Ok(classes),
    }
}

/// Levels are shares of the object seen in all images together.
fn occlusion(level: &str) -> Occlusion {
    match level {
        "v80-100" => Occlusion::None,
        "v40-60" | "v60-80" => Occlusion::Partly,
        "v0-40" => Occlusion::Largely,
        _ => Occlusion::Unspecified,
    }
}

fn object_class(category: &str) -> ObjectClass {
    match category {
        "vehicle.car" | "vehicle.emergency.police" => ObjectClass::Car,
        "vehicle.emergency.ambulance" => ObjectClass::Van,
        "vehicle.truck" | "vehicle.construction" => ObjectClass::Truck,
        "vehicle.bicycle" | "vehicle.motorcycle" => ObjectClass::Cyclist,
        _ if category.starts_with("vehicle.bus") => ObjectClass::Bus,
        _ if category.starts_with("human.pedestrian") => ObjectClass::Pedestrian,
        _ => ObjectClass::Other,
    }
}
