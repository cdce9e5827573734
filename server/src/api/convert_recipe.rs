//! Recipes and explicit scenes as they arrive.

use backlot_engine::camera::{Camera, Distortion};
use backlot_engine::class::ObjectClass;
use backlot_engine::scene::{ClassShare, Histogram, MAX_SIDE_PX, PlacementPreset, Recipe};
use backlot_proto::v1;
use glam::DVec2;

use super::convert_clip::{clip, edits, given_objects};
use super::convert_drive_log::{FieldReader, Place, object_class_from_wire};
use crate::domain::blob::Digest;
use crate::domain::ids::{AssetId, DriveLogId};
use crate::ingest::Violations;
use crate::samples::{Planes, RecipeRequest, SceneObjectRequest, SceneRequest};

/// Collection of the snapshots' resource names.
const SNAPSHOTS: &str = "librarySnapshots/";

/// The recipe with every default filled in.
///
/// # Errors
/// The fields that are missing, malformed or out of range.
pub(super) fn recipe_from_wire(wire: v1::Recipe, seed: u64) -> Result<RecipeRequest, Violations> {
    let mut fields = FieldReader::default();
    let preset = preset(&mut fields, wire.preset);
    let defaults = Recipe::new(preset);
    let objects: Vec<Option<AssetId>> = wire
        .objects
        .iter()
        .enumerate()
        .map(|(i, name)| asset(&mut fields, &format!("recipe.objects[{i}]"), name))
        .collect();
    let classes = classes(&mut fields, &wire.classes);
    let class_shares = class_shares(&mut fields, &wire.class_shares);
    for (i, name) in wire.source_logs.iter().enumerate() {
        if let Err(error) = name.parse::<DriveLogId>() {
            let place = Place::new(format!("recipe.source_logs[{i}]"));
            fields.reject(&place, &error.to_string());
        }
    }
    let edits = edits(&mut fields, wire.edits);
    let given_objects = given_objects(&mut fields, wire.given_objects);
    let clip = clip(&mut fields, wire.clip);
    let sun_direction_world = wire.sun_direction_world.map(|sun| {
        let place = Place::new("recipe.sun_direction_world");
        let direction = fields.vector(&place, Some(sun));
        if direction.normalize_or_zero().z <= 0.0 {
            fields.reject(&place, "does not point up from the ground to the sun");
        }
        direction
    });
    let mut number = |name: &str, value: Option<f64>, default: f64| {
        let place = Place::new(format!("recipe.{name}"));
        value.map_or(default, |value| fields.finite(&place, value))
    };
    let mut jitter = defaults.jitter;
    jitter.x_m = number("jitter_x_m", wire.jitter_x_m, jitter.x_m);
    jitter.y_m = number("jitter_y_m", wire.jitter_y_m, jitter.y_m);
    jitter.heading_rad = number(
        "jitter_heading_rad",
        wire.jitter_heading_rad,
        jitter.heading_rad,
    );
    let [near, far] = defaults.distance_m;
    let [least_clear, most_clear] = defaults.clear_fraction;
    let (least, slack) = (wire.min_height_px, wire.coverage_slack_rad);
    let recipe = Recipe {
        objects: wire.objects.clone(),
        classes,
        class_shares,
        source_logs: wire.source_logs,
        other_logs_only: wire.other_logs_only,
        jitter,
        heading: wire.heading_histogram.map(histogram).or(defaults.heading),
        distance: wire.distance_histogram.map(histogram),
        distance_m: [
            number("min_distance_m", wire.min_distance_m, near),
            number("max_distance_m", wire.max_distance_m, far),
        ],
        clear_fraction: [
            number("min_clear_fraction", wire.min_clear_fraction, least_clear),
            number("max_clear_fraction", wire.max_clear_fraction, most_clear),
        ],
        min_slope: number("min_slope", wire.min_slope, defaults.min_slope),
        min_height_px: number("min_height_px", least, defaults.min_height_px),
        replace_probability: number("replace_probability", Some(wire.replace_probability), 0.0),
        drop_originals: wire.drop_originals,
        insert_shadows: wire.insert_shadows.unwrap_or(defaults.insert_shadows),
        match_light: !wire.keep_light,
        match_tones: !wire.keep_tones,
        longer_side_px: wire.longer_side_px,
        coverage_slack_rad: number("coverage_slack_rad", slack, defaults.coverage_slack_rad),
        camera_id: wire.camera_id,
        frame_indices: wire.frame_indices,
        edits,
        given_objects,
        clip,
        // One bound given alone moves the other of the preset out of its way.
        min_objects: wire.min_objects.unwrap_or_else(|| {
            let most = wire.max_objects.unwrap_or(defaults.max_objects);
            defaults.min_objects.min(most)
        }),
        max_objects: wire.max_objects.unwrap_or_else(|| {
            let least = wire.min_objects.unwrap_or(defaults.min_objects);
            defaults.max_objects.max(least)
        }),
        ..defaults
    };
    if let Err(error) = recipe.validate() {
        fields.reject(&Place::new("recipe"), &error.to_string());
    }
    let snapshot = snapshot(&mut fields, &wire.library_snapshot);
    let background = asset(&mut fields, "recipe.background", &wire.background);
    let planes = Planes {
        depth: !wire.omit_depth,
        instance: !wire.omit_instance,
    };
    let objects = objects.into_iter().flatten().collect();
    let request = background.map(|background| RecipeRequest {
        snapshot,
        background,
        objects,
        recipe,
        sun_direction_world,
        planes,
        seed,
    });
    match request {
        Some(request) => fields.violations.into_result(request),
        None => Err(fields.violations),
    }
}

/// An explicit scene.
///
/// # Errors
/// The fields that are missing, malformed or out of range.
pub(super) fn scene_from_wire(wire: v1::RenderSceneRequest) -> Result<SceneRequest, Violations> {
    let mut fields = FieldReader::default();
    let background = match wire.background.as_str() {
        "" => None,
        name => asset(&mut fields, "background", name),
    };
    let objects = wire.objects.into_iter().enumerate().filter_map(|(i, o)| {
        let place = Place::new(format!("objects[{i}]"));
        let asset = asset(&mut fields, &place.field("asset").path, &o.asset);
        let pose = fields.rigid(&place.field("world_from_object"), o.world_from_object);
        Some(SceneObjectRequest {
            asset: asset?,
            world_from_object: pose,
        })
    });
    let objects = objects.collect();
    let view = fields.required(&Place::new("view"), wire.view);
    let Some(view) = view else {
        return Err(fields.violations);
    };
    let place = Place::new("view");
    let camera = Camera {
        width: view.width,
        height: view.height,
        focal_px: DVec2::new(view.focal_x_px, view.focal_y_px),
        principal_px: DVec2::new(view.principal_x_px, view.principal_y_px),
        distortion: Distortion::None,
    };
    if let Err(error) = camera.validate("camera") {
        fields.reject(&place, &error.to_string());
    } else if camera.width.max(camera.height) > MAX_SIDE_PX {
        fields.reject(&place, &format!("is larger than {MAX_SIDE_PX} pixels"));
    }
    let world_from_camera = fields.rigid(&place.field("world_from_camera"), view.world_from_camera);
    fields.violations.into_result(SceneRequest {
        background,
        objects,
        camera,
        world_from_camera,
        insert_shadows: wire.insert_shadows,
        planes: Planes {
            depth: !wire.omit_depth,
            instance: !wire.omit_instance,
        },
    })
}

fn classes(fields: &mut FieldReader, wire: &[i32]) -> Vec<ObjectClass> {
    let named = wire.iter().enumerate();
    named
        .filter_map(|(i, &value)| class(fields, format!("recipe.classes[{i}]"), value))
        .collect()
}

fn class_shares(fields: &mut FieldReader, wire: &[v1::ClassShare]) -> Vec<ClassShare> {
    let shares = wire.iter().enumerate();
    shares
        .filter_map(|(i, share)| {
            let place = format!("recipe.class_shares[{i}].object_class");
            Some(ClassShare {
                class: class(fields, place, share.object_class)?,
                weight: share.weight,
            })
        })
        .collect()
}

fn class(fields: &mut FieldReader, place: String, value: i32) -> Option<ObjectClass> {
    let class = object_class_from_wire(value);
    if class.is_none() {
        fields.reject(
            &Place::new(place),
            &format!("is {value}, not an ObjectClass"),
        );
    }
    class
}

fn histogram(wire: v1::Histogram) -> Histogram {
    Histogram {
        weights: wire.weights,
    }
}

fn preset(fields: &mut FieldReader, value: i32) -> PlacementPreset {
    use v1::PlacementPreset as Wire;
    match Wire::try_from(value) {
        Ok(Wire::Unspecified | Wire::Default) => PlacementPreset::Default,
        Ok(Wire::Paper) => PlacementPreset::Paper,
        Ok(Wire::PaperNoRt) => PlacementPreset::PaperNoRt,
        Ok(Wire::BalancedHeading) => PlacementPreset::BalancedHeading,
        Ok(Wire::Far) => PlacementPreset::Far,
        Ok(Wire::Dense) => PlacementPreset::Dense,
        Ok(Wire::Occluded) => PlacementPreset::Occluded,
        Ok(Wire::StrangeHeading) => PlacementPreset::StrangeHeading,
        Ok(Wire::OnSlope) => PlacementPreset::OnSlope,
        Ok(Wire::CutIn) => PlacementPreset::CutIn,
        Ok(Wire::DenseQueue) => PlacementPreset::DenseQueue,
        Err(_) => {
            let what = format!("is {value}, not a PlacementPreset");
            fields.reject(&Place::new("recipe.preset"), &what);
            PlacementPreset::Default
        }
    }
}

fn asset(fields: &mut FieldReader, field: &str, name: &str) -> Option<AssetId> {
    match name.parse::<AssetId>() {
        Ok(id) => Some(id),
        Err(error) => {
            fields.reject(&Place::new(field), &error.to_string());
            None
        }
    }
}

fn snapshot(fields: &mut FieldReader, name: &str) -> Option<Digest> {
    if name.is_empty() {
        return None;
    }
    let digest = name.strip_prefix(SNAPSHOTS).and_then(|d| d.parse().ok());
    if digest.is_none() {
        let what = format!("\"{name}\" is not a name of the form {SNAPSHOTS}DIGEST");
        fields.reject(&Place::new("recipe.library_snapshot"), &what);
    }
    digest
}

#[cfg(test)]
mod tests {
    use super::*;

    fn recipe() -> v1::Recipe {
        v1::Recipe {
            background: "assets/street-background-1".into(),
            ..Default::default()
        }
    }

    #[test]
    fn absent_fields_take_the_presets_values() {
        let request = recipe_from_wire(recipe(), 3).unwrap();
        assert_eq!(request.recipe, Recipe::new(PlacementPreset::Default));
        assert_eq!(request.snapshot, None);
        let paper = v1::Recipe {
            preset: v1::PlacementPreset::Paper.into(),
            jitter_y_m: Some(1.0),
            ..recipe()
        };
        let request = recipe_from_wire(paper, 3).unwrap();
        assert_eq!(request.recipe.jitter.x_m, 20.0);
        assert_eq!(request.recipe.jitter.y_m, 1.0);
    }

    #[test]
    fn wrong_fields_are_named() {
        let violation = |recipe: v1::Recipe| recipe_from_wire(recipe, 0).unwrap_err().to_string();
        let background = v1::Recipe::default();
        assert!(violation(background).starts_with("recipe.background:"));
        let objects = v1::Recipe {
            objects: vec!["car".into()],
            ..recipe()
        };
        assert!(violation(objects).starts_with("recipe.objects[0]:"));
        let probability = v1::Recipe {
            replace_probability: 1.5,
            ..recipe()
        };
        assert!(violation(probability).contains("replace_probability"));
        let snapshot = v1::Recipe {
            library_snapshot: "latest".into(),
            ..recipe()
        };
        assert!(violation(snapshot).starts_with("recipe.library_snapshot:"));
        let nan = v1::Recipe {
            coverage_slack_rad: Some(f64::NAN),
            ..recipe()
        };
        assert!(violation(nan).starts_with("recipe.coverage_slack_rad: is NaN"));
        let set = v1::Recipe {
            sun_direction_world: Some(v1::Vector3 {
                x: 1.0,
                y: 0.0,
                z: -0.2,
            }),
            ..recipe()
        };
        assert!(violation(set).starts_with("recipe.sun_direction_world: does not point up"));
    }

    #[test]
    fn one_bound_alone_moves_the_presets_other() {
        let bounds = |min_objects, max_objects| {
            let wire = v1::Recipe {
                min_objects,
                max_objects,
                ..recipe()
            };
            let made = recipe_from_wire(wire, 0).map(|r| r.recipe);
            made.map(|r| (r.min_objects, r.max_objects))
        };
        assert_eq!(bounds(None, None).unwrap(), (1, 3));
        assert_eq!(bounds(Some(0), Some(0)).unwrap(), (0, 0));
        assert_eq!(bounds(Some(8), None).unwrap(), (8, 8));
        assert_eq!(bounds(None, Some(0)).unwrap(), (0, 0));
        assert!(bounds(Some(3), Some(1)).is_err());
    }

    #[test]
    fn every_preset_has_its_name_on_the_wire() {
        for value in 1..=11 {
            let wire = v1::Recipe {
                preset: value,
                ..recipe()
            };
            let preset = recipe_from_wire(wire, 0).unwrap().recipe.preset;
            let name = v1::PlacementPreset::try_from(value).unwrap().as_str_name();
            let engine = serde_json::to_string(&preset).unwrap().to_uppercase();
            assert_eq!(
                name,
                format!("PLACEMENT_PRESET_{}", engine.trim_matches('"'))
            );
        }
        let unknown = v1::Recipe {
            preset: 12,
            ..recipe()
        };
        assert!(recipe_from_wire(unknown, 0).is_err());
    }

    #[test]
    fn distributions_that_are_none_are_refused() {
        let refused = |spoil: fn(&mut v1::Recipe), part: &str| {
            let mut wire = recipe();
            spoil(&mut wire);
            let error = recipe_from_wire(wire, 0).unwrap_err().to_string();
            assert!(error.contains(part), "{error}");
        };
        refused(
            |r| r.heading_histogram = Some(v1::Histogram::default()),
            "heading_histogram has 0 bins",
        );
        refused(
            |r| r.distance_histogram = Some(v1::Histogram { weights: vec![0.0] }),
            "distance_histogram has no weight",
        );
        refused(|r| r.classes = vec![77], "recipe.classes[0]: is 77");
        refused(
            |r| r.class_shares = vec![v1::ClassShare::default()],
            "recipe.class_shares[0].object_class: is 0",
        );
        refused(|r| r.min_distance_m = Some(-3.0), "distance_m -3");
        refused(|r| r.max_distance_m = Some(2.0), "distance_m 6..2");
        refused(|r| r.min_objects = Some(40), "objects");
    }

    #[test]
    fn a_scene_needs_a_view() {
        let error = scene_from_wire(v1::RenderSceneRequest::default()).unwrap_err();
        assert_eq!(error.to_string(), "view: is missing");
    }
}
