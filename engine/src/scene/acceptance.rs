//! Tests a posed object against the view, the other objects and the sight lines.

use super::collision::Occupied;
use super::composition::PlacedObject;
use super::placement::Placer;
use super::projection::amodal_box;
use super::rejection::Rejection;
use super::sight::clear_fraction;
use super::target::Target;

/// Room left between objects: mirrors and errors of the boxes.
pub(super) const CLEARANCE_M: f64 = 0.3;
const MAX_TRUNCATION: f64 = 0.4;
/// An object this close to its own original, or to itself already inserted, would show twice side by side.
const DUPLICATE_M: f64 = 12.0;

impl Placer<'_> {
    pub(super) fn test(&self, object: &PlacedObject, target: &Target) -> Result<(), Rejection> {
        let [near, far] = target.distance_m;
        let offset = object.local_from_object.translation_m - self.local_from_camera.translation_m;
        if !(near..=far).contains(&offset.length()) {
            return Err(Rejection::Distance);
        }
        self.test_view(object)?;
        self.test_collision(object, None)?;
        self.test_sight(object)
    }

    pub(super) fn test_view(&self, object: &PlacedObject) -> Result<(), Rejection> {
        let camera_from_object = self.local_from_camera.inverse() * object.local_from_object;
        let bounds = amodal_box(&self.camera, &camera_from_object, object.size_m)
            .ok_or(Rejection::OutOfView)?;
        let inside = bounds.clipped(&self.camera).ok_or(Rejection::OutOfView)?;
        if bounds.truncation(&self.camera) > MAX_TRUNCATION {
            return Err(Rejection::Truncated);
        }
        if inside.max.y - inside.min.y < self.recipe.min_height_px {
            return Err(Rejection::TooSmall);
        }
        let conditional = !self.recipe.preset.jitters_recorded_poses();
        if conditional && object.beyond_coverage {
            return Err(Rejection::Coverage);
        }
        Ok(())
    }

    pub(super) fn test_collision(
        &self,
        object: &PlacedObject,
        slot: Option<usize>,
    ) -> Result<(), Rejection> {
        let occupied = object.occupied();
        if occupied.collides(&self.ego, CLEARANCE_M) {
            return Err(Rejection::CollidesEgo);
        }
        let placed = &self.placed;
        if placed
            .iter()
            .any(|(_, p)| occupied.collides(p, CLEARANCE_M))
        {
            return Err(Rejection::CollidesPlaced);
        }
        let hits = |(track, original): &(usize, Occupied)| {
            Some(*track) != slot && occupied.collides(original, CLEARANCE_M)
        };
        if self.originals.iter().any(hits) {
            return Err(Rejection::CollidesOriginal);
        }
        Ok(())
    }

    pub(super) fn test_duplicate(
        &self,
        index: usize,
        object: &PlacedObject,
    ) -> Result<(), Rejection> {
        let asset = &self.library[index];
        let at = object.local_from_object.translation_m;
        let near =
            |other: &Occupied| (other.local_from_cuboid.translation_m - at).length() < DUPLICATE_M;
        let again = self.placed.iter().any(|(i, p)| *i == index && near(p));
        let own = |(track, original): &(usize, Occupied)| {
            self.stage.recording.tracks[*track].track_id == asset.source_track_id && near(original)
        };
        let own_log = asset.source_log == self.stage.source_log;
        if again || (own_log && self.originals.iter().any(own)) {
            return Err(Rejection::Duplicate);
        }
        Ok(())
    }

    fn test_sight(&self, object: &PlacedObject) -> Result<(), Rejection> {
        let eye = self.local_from_camera.translation_m;
        let region = self.stage.region;
        let [least, most] = self.recipe.clear_fraction;
        let occupied = object.occupied();
        let tracks = &self.stage.recording.tracks;
        if most < 1.0 {
            let fixed = self.originals.iter();
            let fixed = fixed.filter(|(track, _)| !tracks[*track].moving);
            let environment: Vec<Occupied> = fixed.map(|(_, o)| *o).collect();
            if clear_fraction(eye, &occupied, &environment, region) > most {
                return Err(Rejection::NotOccluded);
            }
        }
        let originals = self.originals.iter().map(|(_, o)| *o);
        let placed = self.placed.iter().map(|(_, o)| *o);
        let mut obstacles: Vec<Occupied> = originals.chain(placed).collect();
        if clear_fraction(eye, &occupied, &obstacles, region) < least {
            return Err(Rejection::Occluded);
        }
        obstacles.push(occupied);
        let hidden = |i: usize| {
            let own = self.originals.len() + i;
            let others: Vec<Occupied> = (0..obstacles.len())
                .filter(|j| *j != own)
                .map(|j| obstacles[j])
                .collect();
            clear_fraction(eye, &obstacles[own], &others, region) < least
        };
        if (0..self.placed.len()).any(hidden) {
            return Err(Rejection::HidesPlaced);
        }
        Ok(())
    }
}
