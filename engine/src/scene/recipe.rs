//! What to make: how many objects, which, and how they are placed.

use serde::{Deserialize, Serialize};

use super::edit::{self, ActorEdit, Edit, GivenObject};
use super::timeline::Clip;
use crate::camera::Rigid;
use crate::class::ObjectClass;
use crate::{Error, Result};

/// How poses are proposed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PlacementPreset {
    /// A free place in the camera's view at an even spread of distances, heading along the road plus jitter, drawn among the
    /// headings from which the asset was observed.
    #[default]
    Default,
    /// The paper's: a recorded pose relative to the ego, jittered; poses beyond the observed views are kept and flagged.
    Paper,
    /// The paper's without rotation and translation: recorded poses as they are.
    PaperNoRt,
}

/// Jitter maxima in the target's ego frame: x forward, y left, heading about the ground's normal.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Jitter {
    pub x_m: f64,
    pub y_m: f64,
    pub heading_rad: f64,
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
    /// The default preset uses only the heading: its positions are free already.
    pub jitter: Jitter,
    /// Probability that an original mover gives its slot to a library object.
    pub replace_probability: f64,
    /// Leaves original movers out instead of replaying them.
    pub drop_originals: bool,
    pub insert_shadows: bool,
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
    /// Distance of inserted objects' centres from the camera.
    pub distance_m: [f64; 2],
    /// Changes to original movers, one a track at most.
    pub edits: Vec<ActorEdit>,
    /// Placed before anything is drawn, in the background's local frame.
    pub given_objects: Vec<GivenObject>,
    pub clip: Clip,
}

/// Objects a sample may hold.
pub const MAX_OBJECTS: u32 = 32;
pub const MAX_SIDE_PX: u32 = 4096;
/// The design starts at 20 degrees. Measured on the generated street, a following car's unseen side then shows as coloured fog
/// over a third of its width; at 8 degrees a sliver of it at most.
const COVERAGE_SLACK_DEG: f64 = 8.0;

impl Recipe {
    pub fn new(preset: PlacementPreset) -> Self {
        let degrees = std::f64::consts::PI / 180.0;
        let jitter = match preset {
            // Traffic keeps its lane; more would look staged.
            PlacementPreset::Default => Jitter {
                x_m: 0.0,
                y_m: 0.0,
                heading_rad: 10.0 * degrees,
            },
            // Section 4.2: T_x, T_y, T_theta.
            PlacementPreset::Paper => Jitter {
                x_m: 20.0,
                y_m: 5.0,
                heading_rad: 30.0 * degrees,
            },
            PlacementPreset::PaperNoRt => Jitter {
                x_m: 0.0,
                y_m: 0.0,
                heading_rad: 0.0,
            },
        };
        Self {
            preset,
            min_objects: 1,
            max_objects: 3,
            objects: Vec::new(),
            classes: Vec::new(),
            jitter,
            replace_probability: 0.0,
            drop_originals: false,
            insert_shadows: false,
            match_tones: true,
            longer_side_px: 0,
            coverage_slack_rad: COVERAGE_SLACK_DEG * degrees,
            camera_id: String::new(),
            frame_indices: Vec::new(),
            // Nearer, a 0.05 m voxel is over 3 px; further, a car is under 20 px high.
            distance_m: [6.0, 40.0],
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
        let limits = [
            ("jitter_x_m", self.jitter.x_m, 200.0),
            ("jitter_y_m", self.jitter.y_m, 200.0),
            (
                "jitter_heading_rad",
                self.jitter.heading_rad,
                std::f64::consts::PI,
            ),
            ("replace_probability", self.replace_probability, 1.0),
            (
                "coverage_slack_rad",
                self.coverage_slack_rad,
                std::f64::consts::PI,
            ),
        ];
        for (field, value, limit) in limits {
            if !(0.0..=limit).contains(&value) {
                return Err(Error::invalid(format!(
                    "recipe: {field} {value} is outside 0..={limit}"
                )));
            }
        }
        let [near, far] = self.distance_m;
        if !(near > 0.0 && near < far && far.is_finite()) {
            return Err(Error::invalid(format!(
                "recipe: distance_m {near}..{far} is not an ascending positive range"
            )));
        }
        if self.longer_side_px > MAX_SIDE_PX {
            return Err(Error::invalid(format!(
                "recipe: longer_side_px {} is over {MAX_SIDE_PX}",
                self.longer_side_px
            )));
        }
        edit::validate(&self.edits, &self.given_objects)?;
        self.clip.validate()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn presets_are_valid_and_bad_ranges_are_named() {
        for preset in [
            PlacementPreset::Default,
            PlacementPreset::Paper,
            PlacementPreset::PaperNoRt,
        ] {
            Recipe::new(preset).validate().unwrap();
        }
        type Spoil = (&'static str, fn(&mut Recipe));
        let spoil: [Spoil; 5] = [
            ("jitter_x_m", |r| r.jitter.x_m = -1.0),
            ("coverage_slack_rad", |r| r.coverage_slack_rad = f64::NAN),
            ("objects", |r| r.min_objects = 4),
            ("distance_m", |r| r.distance_m = [40.0, 6.0]),
            ("longer_side_px", |r| r.longer_side_px = 5000),
        ];
        for (field, spoil) in spoil {
            let mut recipe = Recipe::new(PlacementPreset::Default);
            spoil(&mut recipe);
            let message = recipe.validate().unwrap_err().to_string();
            assert!(message.contains(field), "{message}");
        }
    }
}
