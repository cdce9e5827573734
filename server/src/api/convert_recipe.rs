//! Recipes and explicit scenes as they arrive.

use backlot_engine::camera::{Camera, Distortion};
use backlot_engine::scene::{MAX_SIDE_PX, PlacementPreset, Recipe};
use backlot_proto::v1;
use glam::DVec2;

use super::convert_clip::{clip, edits, given_objects};
use super::convert_drive_log::{FieldReader, Place, object_class_from_wire};
use crate::domain::blob::Digest;
use crate::domain::ids::AssetId;
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
    let classes = wire.classes.iter().enumerate().filter_map(|(i, &value)| {
        let class = object_class_from_wire(value);
        if class.is_none() {
            let place = Place::new(format!("recipe.classes[{i}]"));
            fields.reject(&place, &format!("is {value}, not an ObjectClass"));
        }
        class
    });
    let classes = classes.collect();
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
    let (min_objects, max_objects) = match (wire.min_objects, wire.max_objects) {
        (0, 0) => (defaults.min_objects, defaults.max_objects),
        range => range,
    };
    let edits = edits(&mut fields, wire.edits);
    let given_objects = given_objects(&mut fields, wire.given_objects);
    let clip = clip(&mut fields, wire.clip);
    let mut number = |name: &str, value: Option<f64>, default: f64| {
        let place = Place::new(format!("recipe.{name}"));
        value.map_or(default, |value| fields.finite(&place, value))
    };
    let slack = wire.coverage_slack_rad;
    let recipe = Recipe {
        min_objects,
        max_objects,
        objects: wire.objects.clone(),
        classes,
        jitter,
        replace_probability: number("replace_probability", Some(wire.replace_probability), 0.0),
        drop_originals: wire.drop_originals,
        insert_shadows: wire.insert_shadows,
        match_tones: !wire.keep_tones,
        longer_side_px: wire.longer_side_px,
        coverage_slack_rad: number("coverage_slack_rad", slack, defaults.coverage_slack_rad),
        camera_id: wire.camera_id,
        frame_indices: wire.frame_indices,
        edits,
        given_objects,
        clip,
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

fn preset(fields: &mut FieldReader, value: i32) -> PlacementPreset {
    match v1::PlacementPreset::try_from(value) {
        Ok(v1::PlacementPreset::Unspecified | v1::PlacementPreset::Default) => {
            PlacementPreset::Default
        }
        Ok(v1::PlacementPreset::Paper) => PlacementPreset::Paper,
        Ok(v1::PlacementPreset::PaperNoRt) => PlacementPreset::PaperNoRt,
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
    }

    #[test]
    fn a_scene_needs_a_view() {
        let error = scene_from_wire(v1::RenderSceneRequest::default()).unwrap_err();
        assert_eq!(error.to_string(), "view: is missing");
    }
}
