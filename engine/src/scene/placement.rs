//! Proposes poses for objects and tests them.

use glam::{DVec2, DVec3};

use super::collision::Occupied;
use super::composition::{Candidate, Composition, Origin, PlacedObject, Stage};
use super::coverage::{covers, wrap};
use super::footprint::Footprint;
use super::movement::{ClipSpace, Movement};
use super::projection::amodal_box;
use super::random::Draws;
use super::recipe::{PlacementPreset, Recipe};
use super::recording::RecordedFrame;
use super::rejection::Rejection;
use super::sight::clear_fraction;
use crate::camera::{Camera, Rigid};

/// Everything known while one sample is composed.
pub(super) struct Placer<'a> {
    pub(super) stage: Stage<'a>,
    pub(super) library: &'a [Candidate],
    pub(super) recipe: &'a Recipe,
    /// Originals that stay in the sample, by track index.
    pub(super) originals: Vec<(usize, Occupied)>,
    eligible: Vec<usize>,
    placed: Vec<Occupied>,
    ego: Occupied,
    camera: Camera,
    local_from_camera: Rigid,
    local_from_ego: Rigid,
    /// Free cells in view as (distance from the camera, index), ascending.
    visible_cells: Vec<(f64, usize)>,
}

/// Room left between objects: mirrors and errors of the boxes.
pub(super) const CLEARANCE_M: f64 = 0.3;
/// Free ground asked for around a footprint.
pub(super) const FOOTPRINT_MARGIN_M: f64 = 0.1;
/// Half the width of the ring of cells around a drawn distance.
const RING_M: f64 = 1.5;
/// A detector learns little from less.
const MIN_HEIGHT_PX: f64 = 12.0;
const MAX_TRUNCATION: f64 = 0.4;
/// Fraction of sight lines that must be clear.
const MIN_CLEAR: f64 = 0.35;
/// An object this close to its own original would show twice side by side.
const DUPLICATE_M: f64 = 12.0;
/// Lateral distance from the ego's path within which traffic shares its direction.
const OWN_LANE_M: f64 = 2.0;
/// Bins over which headings are drawn conditionally on coverage.
const HEADING_BINS: u32 = 41;
/// A replacement's length and width may differ this much from the original's.
const REPLACE_SIZE_RATIO: f64 = 1.35;

impl<'a> Placer<'a> {
    pub(super) fn new(
        stage: Stage<'a>,
        library: &'a [Candidate],
        eligible: Vec<usize>,
        recipe: &'a Recipe,
        composition: &Composition,
    ) -> Self {
        let mut placer = Self {
            stage,
            library,
            recipe,
            originals: Vec::new(),
            eligible,
            placed: Vec::new(),
            ego: ego_box(&composition.local_from_ego),
            camera: composition.camera,
            local_from_camera: composition.local_from_camera,
            local_from_ego: composition.local_from_ego,
            visible_cells: Vec::new(),
        };
        placer.visible_cells = placer.find_visible_cells();
        placer
    }

    /// One attempt at a new object.
    pub(super) fn propose(&self, draws: &mut Draws) -> Result<PlacedObject, Rejection> {
        if self.eligible.is_empty() {
            return Err(Rejection::NoFreePlace);
        }
        let index = self.eligible[draws.below(self.eligible.len())];
        let asset = &self.library[index];
        let recorded = match self.recipe.preset {
            PlacementPreset::Default => None,
            _ if asset.ego_from_object.is_empty() => None,
            _ => Some(asset.ego_from_object[draws.below(asset.ego_from_object.len())]),
        };
        let (at, heading) = match recorded {
            Some(pose) => self.jittered(&pose, draws),
            None => self.free_pose(asset, draws)?,
        };
        let footprint = Footprint::new(at, heading, asset.size_m).grown(FOOTPRINT_MARGIN_M);
        let plane = self.stage.region.support(&footprint)?;
        let local_from_object = plane.stand(at, heading, asset.size_m.z);
        let object = self.posed(index, local_from_object, Origin::Inserted);
        self.test(&object)?;
        self.test_duplicate(asset, &object)?;
        Ok(object)
    }

    /// One attempt at putting a library object into the slot of original `track`.
    pub(super) fn replace(
        &self,
        track: usize,
        original: &Occupied,
        draws: &mut Draws,
    ) -> Result<PlacedObject, Rejection> {
        if self.eligible.is_empty() {
            return Err(Rejection::SizeMismatch);
        }
        let index = self.eligible[draws.below(self.eligible.len())];
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
        self.placed.push(object.occupied());
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
        if self.recipe.preset != PlacementPreset::Default {
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

    /// T23: the recorded pose is carried from its ego to this one and jittered along this ego's axes.
    fn jittered(&self, ego_from_object: &Rigid, draws: &mut Draws) -> (DVec2, f64) {
        let jitter = self.recipe.jitter;
        let offset = DVec3::new(draws.jitter(jitter.x_m), draws.jitter(jitter.y_m), 0.0);
        let turn = draws.jitter(jitter.heading_rad);
        let at = self
            .local_from_ego
            .point(ego_from_object.translation_m + offset);
        let heading = (self.local_from_ego * *ego_from_object).heading_rad() + turn;
        (at.truncate(), wrap(heading))
    }

    /// A free cell at an evenly drawn distance, and a heading along the road from which the asset was observed.
    fn free_pose(&self, asset: &Candidate, draws: &mut Draws) -> Result<(DVec2, f64), Rejection> {
        let [near, far] = self.recipe.distance_m;
        let distance = draws.uniform(near, far);
        let first = self
            .visible_cells
            .partition_point(|c| c.0 < distance - RING_M);
        let last = self
            .visible_cells
            .partition_point(|c| c.0 <= distance + RING_M);
        if first == last {
            return Err(Rejection::NoFreePlace);
        }
        let (_, cell) = self.visible_cells[first + draws.below(last - first)];
        let half = self.stage.region.cell_m * 0.5;
        let at =
            self.stage.region.centre(cell) + DVec2::new(draws.jitter(half), draws.jitter(half));
        let (road, lateral) = self.road_at(at);
        let limit = self.recipe.jitter.heading_rad;
        let both_ways = lateral.abs() > OWN_LANE_M;
        let mut headings = Vec::with_capacity(2 * HEADING_BINS as usize);
        for turn in [0.0, std::f64::consts::PI] {
            if turn > 0.0 && !both_ways {
                continue;
            }
            for bin in 0..HEADING_BINS {
                let fraction = 2.0 * f64::from(bin) / f64::from(HEADING_BINS - 1) - 1.0;
                let heading = wrap(road + turn + fraction * limit);
                if self.covered(asset, &self.upright(asset, at, heading)) {
                    headings.push(heading);
                }
            }
        }
        if headings.is_empty() {
            return Err(Rejection::Coverage);
        }
        Ok((at, headings[draws.below(headings.len())]))
    }

    fn upright(&self, asset: &Candidate, at: DVec2, heading: f64) -> Rigid {
        let ground = self.stage.region.ground_height(at).unwrap_or(0.0);
        Rigid::from_heading(heading, at.extend(ground + asset.size_m.z * 0.5))
    }

    /// Heading of the driven path nearest to a point, and the point's distance left of it.
    fn road_at(&self, at: DVec2) -> (f64, f64) {
        let frames = &self.stage.recording.frames;
        let distance =
            |i: &usize| (frames[*i].local_from_ego.translation_m.truncate() - at).length_squared();
        let nearest = (0..frames.len())
            .min_by(|a, b| distance(a).total_cmp(&distance(b)))
            .expect("a composition has a frame");
        let ego = frames[nearest].local_from_ego;
        let lateral = ego.inverse().point(at.extend(ego.translation_m.z)).y;
        (ego.heading_rad(), lateral)
    }

    fn find_visible_cells(&self) -> Vec<(f64, usize)> {
        let region = self.stage.region;
        let camera_from_local = self.local_from_camera.inverse();
        let [near, far] = self.recipe.distance_m;
        let mut cells: Vec<(f64, usize)> = region
            .free_cells()
            .filter_map(|i| {
                let p = camera_from_local.point(region.centre(i).extend(region.ground_m[i]));
                let distance = p.length();
                let pixel = self.camera.project(p)?;
                let inside = pixel.x >= 0.0 && pixel.x < f64::from(self.camera.width);
                (inside && distance >= near && distance <= far).then_some((distance, i))
            })
            .collect();
        cells.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        cells
    }

    fn test(&self, object: &PlacedObject) -> Result<(), Rejection> {
        let [near, far] = self.recipe.distance_m;
        let offset = object.local_from_object.translation_m - self.local_from_camera.translation_m;
        if !(near..=far).contains(&offset.length()) {
            return Err(Rejection::Distance);
        }
        self.test_view(object)?;
        self.test_collision(object, None)?;
        self.test_sight(object)
    }

    fn test_view(&self, object: &PlacedObject) -> Result<(), Rejection> {
        let camera_from_object = self.local_from_camera.inverse() * object.local_from_object;
        let bounds = amodal_box(&self.camera, &camera_from_object, object.size_m)
            .ok_or(Rejection::OutOfView)?;
        let inside = bounds.clipped(&self.camera).ok_or(Rejection::OutOfView)?;
        if bounds.truncation(&self.camera) > MAX_TRUNCATION {
            return Err(Rejection::Truncated);
        }
        if inside.max.y - inside.min.y < MIN_HEIGHT_PX {
            return Err(Rejection::TooSmall);
        }
        let conditional = self.recipe.preset == PlacementPreset::Default;
        if conditional && object.beyond_coverage {
            return Err(Rejection::Coverage);
        }
        Ok(())
    }

    fn test_collision(&self, object: &PlacedObject, slot: Option<usize>) -> Result<(), Rejection> {
        let occupied = object.occupied();
        if occupied.collides(&self.ego, CLEARANCE_M) {
            return Err(Rejection::CollidesEgo);
        }
        if self
            .placed
            .iter()
            .any(|p| occupied.collides(p, CLEARANCE_M))
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

    fn test_duplicate(&self, asset: &Candidate, object: &PlacedObject) -> Result<(), Rejection> {
        if asset.source_log != self.stage.source_log {
            return Ok(());
        }
        let at = object.local_from_object.translation_m;
        let beside = |(track, original): &(usize, Occupied)| {
            self.stage.recording.tracks[*track].track_id == asset.source_track_id
                && (original.local_from_cuboid.translation_m - at).length() < DUPLICATE_M
        };
        if self.originals.iter().any(beside) {
            return Err(Rejection::Duplicate);
        }
        Ok(())
    }

    fn test_sight(&self, object: &PlacedObject) -> Result<(), Rejection> {
        let eye = self.local_from_camera.translation_m;
        let originals = self.originals.iter().map(|(_, o)| *o);
        let mut obstacles: Vec<Occupied> = originals.chain(self.placed.iter().copied()).collect();
        let occupied = object.occupied();
        if clear_fraction(eye, &occupied, &obstacles, self.stage.region) < MIN_CLEAR {
            return Err(Rejection::Occluded);
        }
        obstacles.push(occupied);
        let hidden = |(i, placed): (usize, &Occupied)| {
            let own = self.originals.len() + i;
            let others: Vec<Occupied> = (0..obstacles.len())
                .filter(|j| *j != own)
                .map(|j| obstacles[j])
                .collect();
            clear_fraction(eye, placed, &others, self.stage.region) < MIN_CLEAR
        };
        if self.placed.iter().enumerate().any(hidden) {
            return Err(Rejection::HidesPlaced);
        }
        Ok(())
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
