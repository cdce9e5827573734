//! Places one object after another in a sample.

use glam::DVec3;

use super::collision::Occupied;
use super::composition::{Candidate, Composition, Origin, PlacedObject, Stage};
use super::coverage::covers;
use super::footprint::Footprint;
use super::movement::{ClipSpace, Movement};
use super::places::Places;
use super::projection::amodal_box;
use super::random::Draws;
use super::recipe::Recipe;
use super::recording::RecordedFrame;
use super::rejection::Rejection;
use super::target::Target;
use crate::Result;
use crate::camera::{Camera, Rigid};

/// Everything known while one sample is composed.
pub(super) struct Placer<'a> {
    pub(super) stage: Stage<'a>,
    pub(super) library: &'a [Candidate],
    pub(super) recipe: &'a Recipe,
    /// Originals that stay in the sample, by track index.
    pub(super) originals: Vec<(usize, Occupied)>,
    /// Library objects of the sample, with their asset.
    pub(super) placed: Vec<(usize, Occupied)>,
    pub(super) ego: Occupied,
    pub(super) camera: Camera,
    pub(super) local_from_camera: Rigid,
    pub(super) local_from_ego: Rigid,
    pub(super) places: Places,
}

/// Free ground asked for around a footprint.
pub(super) const FOOTPRINT_MARGIN_M: f64 = 0.1;
/// A replacement's length and width may differ this much from the original's.
const REPLACE_SIZE_RATIO: f64 = 1.35;

impl<'a> Placer<'a> {
    pub(super) fn new(
        stage: Stage<'a>,
        library: &'a [Candidate],
        recipe: &'a Recipe,
        composition: &Composition,
    ) -> Self {
        Self {
            stage,
            library,
            recipe,
            originals: Vec::new(),
            placed: Vec::new(),
            ego: ego_box(&composition.local_from_ego),
            camera: composition.camera,
            local_from_camera: composition.local_from_camera,
            local_from_ego: composition.local_from_ego,
            places: Places::default(),
        }
    }

    /// Looks for places once the originals are known.
    pub(super) fn find_places(&mut self) {
        let tracks = &self.stage.recording.tracks;
        let fixed: Vec<Occupied> = self
            .originals
            .iter()
            .filter(|(track, _)| !tracks[*track].moving)
            .map(|(_, occupied)| *occupied)
            .collect();
        let pose = &self.local_from_camera;
        self.places = Places::new(&self.stage, self.recipe, &self.camera, pose, &fixed);
    }

    /// One attempt at a new object.
    pub(super) fn propose(
        &self,
        target: &Target,
        draws: &mut Draws,
    ) -> Result<PlacedObject, Rejection> {
        let index = target.assets[draws.below(target.assets.len())];
        let asset = &self.library[index];
        let (at, heading) = self.draw_pose(asset, target, draws)?;
        let footprint = Footprint::new(at, heading, asset.size_m).grown(FOOTPRINT_MARGIN_M);
        let plane = self.stage.region.support(&footprint)?;
        if plane.slope.length() < self.recipe.min_slope {
            return Err(Rejection::TooFlat);
        }
        let local_from_object = plane.stand(at, heading, asset.size_m.z);
        let object = self.posed(index, local_from_object, Origin::Inserted);
        self.test(&object, target)?;
        self.test_duplicate(index, &object)?;
        Ok(object)
    }

    /// One attempt at putting one of `assets` into the slot of original `track`.
    pub(super) fn replace(
        &self,
        assets: &[usize],
        track: usize,
        original: &Occupied,
        draws: &mut Draws,
    ) -> Result<PlacedObject, Rejection> {
        if assets.is_empty() {
            return Err(Rejection::NoAsset);
        }
        let index = assets[draws.below(assets.len())];
        let asset = &self.library[index];
        let recorded = &self.stage.recording.tracks[track];
        if asset.source_log == self.stage.source_log && asset.source_track_id == recorded.track_id {
            return Err(Rejection::Duplicate);
        }
        let ratio = asset.size_m.truncate() / original.size_m.truncate();
        let fits = ratio.max(ratio.recip()).max_element() <= REPLACE_SIZE_RATIO;
        if !fits || asset.class.is_vehicle() != recorded.class.is_vehicle() {
            return Err(Rejection::SizeMismatch);
        }
        // Same bottom plane and heading; the ground under the original may never have been seen.
        let lift = DVec3::Z * ((asset.size_m.z - original.size_m.z) * 0.5);
        let pose = original.local_from_cuboid;
        let local_from_object = Rigid::new(pose.rotation, pose.point(lift));
        let object = self.posed(index, local_from_object, Origin::Replaced);
        self.test_view(&object)?;
        self.test_collision(&object, Some(track))?;
        Ok(object)
    }

    pub(super) fn accept(&mut self, object: PlacedObject, objects: &mut Vec<PlacedObject>) {
        if let Some(asset) = object.asset {
            self.placed.push((asset, object.occupied()));
        }
        objects.push(object);
    }

    /// A given pose is asked no more than to touch nothing; whether the asset was seen from there is noted.
    pub(super) fn test_given(
        &self,
        mut movement: Movement,
        track: Option<usize>,
    ) -> Result<Movement, Rejection> {
        self.test_collision(&movement.object, track)?;
        let asset = movement.object.asset.expect("given objects have assets");
        let pose = movement.object.local_from_object;
        movement.object.beyond_coverage = !self.covered(&self.library[asset], &pose);
        Ok(movement)
    }

    /// Where poses are drawn conditionally on coverage, the later frames of a clip may not show an object's unknown sides either.
    pub(super) fn test_later_views(
        &self,
        movement: Movement,
        clip: &ClipSpace<'_>,
    ) -> Result<Movement, Rejection> {
        if self.recipe.preset.jitters_recorded_poses() {
            return Ok(movement);
        }
        for k in 1..clip.frames.len() {
            let Some(object) = clip.at_frame(&movement, k) else {
                continue;
            };
            let frame = &self.stage.recording.frames[clip.frames[k]];
            let camera_from_object = frame.local_from_camera.inverse() * object.local_from_object;
            let in_view = amodal_box(&self.camera, &camera_from_object, object.size_m)
                .and_then(|bounds| bounds.clipped(&self.camera));
            if in_view.is_some() && beyond_coverage(self.library, self.recipe, frame, &object) {
                return Err(Rejection::Coverage);
            }
        }
        Ok(movement)
    }

    pub(super) fn posed(
        &self,
        index: usize,
        local_from_object: Rigid,
        origin: Origin,
    ) -> PlacedObject {
        let asset = &self.library[index];
        PlacedObject {
            instance_id: 0,
            origin,
            class: asset.class,
            size_m: asset.size_m,
            local_from_object,
            asset: Some(index),
            track_id: None,
            beyond_coverage: !self.covered(asset, &local_from_object),
            velocity_mps: None,
        }
    }

    fn covered(&self, asset: &Candidate, local_from_object: &Rigid) -> bool {
        let eye = local_from_object
            .inverse()
            .point(self.local_from_camera.translation_m);
        covers(&asset.coverage, eye, self.recipe.coverage_slack_rad)
    }
}

/// Whether a frame's camera sees an object from where its asset was not observed; never for objects without an asset.
pub(super) fn beyond_coverage(
    library: &[Candidate],
    recipe: &Recipe,
    frame: &RecordedFrame,
    object: &PlacedObject,
) -> bool {
    let object_from_local = object.local_from_object.inverse();
    let eye = object_from_local.point(frame.local_from_camera.translation_m);
    let asset = object.asset.map(|i| &library[i]);
    asset.is_some_and(|asset| !covers(&asset.coverage, eye, recipe.coverage_slack_rad))
}

/// Covers a car whose ego frame is at the rear axle (KITTI's IMU, nuScenes) or on the roof (KITTI's Velodyne).
pub(super) fn ego_box(local_from_ego: &Rigid) -> Occupied {
    Occupied {
        local_from_cuboid: Rigid::new(
            local_from_ego.rotation,
            local_from_ego.point(DVec3::new(0.6, 0.0, 0.0)),
        ),
        size_m: DVec3::new(6.8, 2.2, 5.0),
    }
}
