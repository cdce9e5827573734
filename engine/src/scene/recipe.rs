//! What to make: how many objects, which, and how they are placed.

use serde::{Deserialize, Serialize};

use super::edit::{self, ActorEdit, Edit, GivenObject};
use super::histogram::{Histogram, validate_weights};
use super::preset::PlacementPreset;
use super::timeline::Clip;
use crate::camera::Rigid;
use crate::class::ObjectClass;
use crate::{Error, Result};

/// Jitter maxima in the target's ego frame: x forward, y left, heading about the ground's normal.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Jitter {
    pub x_m: f64,
    pub y_m: f64,
    pub heading_rad: f64,
}

/// How often a class is drawn against the others.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ClassShare {
    pub class: ObjectClass,
    pub weight: f64,
}

/// A recipe with every default filled in.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Recipe {
    pub preset: PlacementPreset,
    /// Objects inserted a sample, both ends included.
    pub min_objects: u32,
    pub max_objects: u32,
    /// Asset names to draw from; empty means every library object.
    pub objects: Vec<String>,
    /// Classes to draw from; empty means every class.
    pub classes: Vec<ObjectClass>,
    /// Wanted distribution of classes; empty means as many of each as there are assets.
    pub class_shares: Vec<ClassShare>,
    /// Logs to draw objects from; empty means every log.
    pub source_logs: Vec<String>,
    /// Draws no object of the background's own log.
    pub other_logs_only: bool,
    /// All but the paper's presets use only the heading: their positions are free already.
    pub jitter: Jitter,
    /// Wanted distribution of camera-relative heading over -pi..pi: the object's heading minus the direction of the horizontal
    /// line of sight to its centre. `None` draws by the preset.
    pub heading: Option<Histogram>,
    /// Wanted distribution over `distance_m`; `None` is even.
    pub distance: Option<Histogram>,
    /// Distance of inserted objects' centres from the camera.
    pub distance_m: [f64; 2],
    /// Least fraction of sight lines to an inserted object that nothing cuts, and largest that the environment leaves: under 1,
    /// it must hide part of the object.
    pub clear_fraction: [f64; 2],
    /// Least slope of the ground under inserted objects.
    pub min_slope: f64,
    /// Least height of an inserted object's amodal box in pixels.
    pub min_height_px: f64,
    /// Probability that an original mover gives its slot to a library object.
    pub replace_probability: f64,
    /// Leaves original movers out instead of replaying them.
    pub drop_originals: bool,
    /// Inserted and replacing objects throw shadows.
    pub insert_shadows: bool,
    /// Moves inserted and replacing objects from the sunlight they were recorded in into that of their place.
    pub match_light: bool,
    /// Matches the light of objects from other logs to the recorded frame.
    pub match_tones: bool,
    /// Longer side of the image in pixels; 0 means as recorded.
    pub longer_side_px: u32,
    /// Slack beyond the observed views.
    pub coverage_slack_rad: f64,
    /// Empty means the background's first camera.
    pub camera_id: String,
    /// Recorded frames to draw from; empty means all.
    pub frame_indices: Vec<u32>,
    /// Changes to original movers, one a track at most.
    pub edits: Vec<ActorEdit>,
    /// Placed before anything is drawn, in the background's local frame.
    pub given_objects: Vec<GivenObject>,
    pub clip: Clip,
}

/// Objects a sample may hold.
pub const MAX_OBJECTS: u32 = 32;
pub const MAX_SIDE_PX: u32 = 4096;
/// A road steeper than 45 degrees is an error of the field.
const MAX_SLOPE: f64 = 1.0;

impl Recipe {
    /// The preset's values, with everything else left as recorded.
    pub fn new(preset: PlacementPreset) -> Self {
        let values = preset.values();
        Self {
            preset,
            min_objects: values.objects.0,
            max_objects: values.objects.1,
            objects: Vec::new(),
            classes: Vec::new(),
            class_shares: Vec::new(),
            source_logs: Vec::new(),
            other_logs_only: false,
            jitter: values.jitter,
            heading: values.heading_bins.map(Histogram::even),
            distance: None,
            distance_m: values.distance_m,
            clear_fraction: values.clear_fraction,
            min_slope: values.min_slope,
            min_height_px: values.min_height_px,
            replace_probability: 0.0,
            drop_originals: false,
            insert_shadows: true,
            match_light: true,
            match_tones: true,
            longer_side_px: 0,
            coverage_slack_rad: values.coverage_slack_rad,
            camera_id: String::new(),
            frame_indices: Vec::new(),
            edits: Vec::new(),
            given_objects: Vec::new(),
            clip: Clip::default(),
        }
    }

    /// Takes given trajectories from another frame, whose z axis is up as well, into this recipe's.
    pub fn transform_trajectories(&mut self, target_from_source: &Rigid) {
        for edit in &mut self.edits {
            if let Edit::Follow(path) = &mut edit.edit {
                *path = path.transformed(target_from_source);
            }
        }
        for given in &mut self.given_objects {
            given.trajectory = given.trajectory.transformed(target_from_source);
        }
    }

    /// Checks ranges.
    ///
    /// # Errors
    /// [`Error::Invalid`] naming the field.
    pub fn validate(&self) -> Result<()> {
        if self.min_objects > self.max_objects || self.max_objects > MAX_OBJECTS {
            return Err(Error::invalid(format!(
                "recipe: objects {}..={} must be an ascending range up to {MAX_OBJECTS}",
                self.min_objects, self.max_objects
            )));
        }
        self.validate_numbers()?;
        let [near, far] = self.distance_m;
        if !(near > 0.0 && near < far && far.is_finite()) {
            return Err(Error::invalid(format!(
                "recipe: distance_m {near}..{far} is not an ascending positive range"
            )));
        }
        let [least, most] = self.clear_fraction;
        if least > most {
            return Err(Error::invalid(format!(
                "recipe: clear_fraction {least}..{most} is not an ascending range"
            )));
        }
        if self.longer_side_px > MAX_SIDE_PX {
            return Err(Error::invalid(format!(
                "recipe: longer_side_px {} is over {MAX_SIDE_PX}",
                self.longer_side_px
            )));
        }
        self.validate_distributions()?;
        edit::validate(&self.edits, &self.given_objects)?;
        self.clip.validate()
    }

    fn validate_numbers(&self) -> Result<()> {
        let half_turn = std::f64::consts::PI;
        let limits = [
            ("jitter_x_m", self.jitter.x_m, 200.0),
            ("jitter_y_m", self.jitter.y_m, 200.0),
            ("jitter_heading_rad", self.jitter.heading_rad, half_turn),
            ("replace_probability", self.replace_probability, 1.0),
            ("coverage_slack_rad", self.coverage_slack_rad, half_turn),
            ("min_clear_fraction", self.clear_fraction[0], 1.0),
            ("max_clear_fraction", self.clear_fraction[1], 1.0),
            ("min_slope", self.min_slope, MAX_SLOPE),
            ("min_height_px", self.min_height_px, f64::from(MAX_SIDE_PX)),
        ];
        for (field, value, limit) in limits {
            if !(0.0..=limit).contains(&value) {
                return Err(Error::invalid(format!(
                    "recipe: {field} {value} is outside 0..={limit}"
                )));
            }
        }
        Ok(())
    }

    fn validate_distributions(&self) -> Result<()> {
        if let Some(heading) = &self.heading {
            heading.validate("heading_histogram")?;
            if self.preset.jitters_recorded_poses() {
                return Err(Error::invalid(
                    "recipe: heading_histogram has no meaning under the paper's presets, which jitter recorded poses; use another preset",
                ));
            }
        }
        if let Some(distance) = &self.distance {
            distance.validate("distance_histogram")?;
        }
        if self.class_shares.is_empty() {
            return Ok(());
        }
        for (i, share) in self.class_shares.iter().enumerate() {
            let class = share.class;
            if self.class_shares[..i].iter().any(|s| s.class == class) {
                return Err(Error::invalid(format!(
                    "recipe: class_shares names {} twice",
                    class.name()
                )));
            }
            if !self.classes.is_empty() && !self.classes.contains(&class) {
                return Err(Error::invalid(format!(
                    "recipe: class_shares names {}, which classes leaves out",
                    class.name()
                )));
            }
        }
        let weights: Vec<f64> = self.class_shares.iter().map(|s| s.weight).collect();
        validate_weights(&weights, "class_shares")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn presets_are_valid_and_bad_ranges_are_named() {
        for preset in PlacementPreset::ALL {
            Recipe::new(preset).validate().unwrap();
        }
        type Spoil = (&'static str, fn(&mut Recipe));
        let spoil: [Spoil; 12] = [
            ("jitter_x_m", |r| r.jitter.x_m = -1.0),
            ("coverage_slack_rad", |r| r.coverage_slack_rad = f64::NAN),
            ("objects", |r| r.min_objects = 4),
            ("objects", |r| r.max_objects = 33),
            ("distance_m", |r| r.distance_m = [40.0, 6.0]),
            ("distance_m", |r| r.distance_m = [-5.0, 6.0]),
            ("longer_side_px", |r| r.longer_side_px = 5000),
            ("clear_fraction", |r| r.clear_fraction = [0.8, 0.2]),
            ("min_slope", |r| r.min_slope = -0.1),
            ("heading_histogram", |r| {
                r.heading = Some(Histogram::even(0))
            }),
            ("distance_histogram", |r| {
                r.distance = Some(Histogram {
                    weights: vec![1.0, -2.0],
                })
            }),
            ("class_shares", |r| r.class_shares = vec![share(0.0)]),
        ];
        for (field, spoil) in spoil {
            let mut recipe = Recipe::new(PlacementPreset::Default);
            spoil(&mut recipe);
            let message = recipe.validate().unwrap_err().to_string();
            assert!(message.contains(field), "{message}");
        }
    }

    fn share(weight: f64) -> ClassShare {
        ClassShare {
            class: ObjectClass::Car,
            weight,
        }
    }

    #[test]
    fn fields_that_contradict_each_other_are_refused() {
        let mut recipe = Recipe::new(PlacementPreset::Paper);
        recipe.heading = Some(Histogram::even(12));
        assert!(recipe.validate().is_err());
        let mut recipe = Recipe::new(PlacementPreset::Default);
        recipe.class_shares = vec![share(1.0), share(2.0)];
        assert!(recipe.validate().unwrap_err().to_string().contains("twice"));
        recipe.class_shares = vec![share(1.0)];
        recipe.validate().unwrap();
        recipe.classes = vec![ObjectClass::Van];
        let message = recipe.validate().unwrap_err().to_string();
        assert!(message.contains("car"), "{message}");
    }
}
