//! Draws poses: where an object might stand and which way it might look.

use std::f64::consts::PI;

use glam::{DVec2, DVec3};

use super::arcs::{Arcs, wrap};
use super::composition::Candidate;
use super::coverage::{nearest_m, observed_headings};
use super::placement::Placer;
use super::preset::PlacementPreset;
use super::random::Draws;
use super::rejection::Rejection;
use super::road::{Road, RoadPlace};
use super::target::Target;
use crate::camera::Rigid;

/// Half the width of the ring of cells around a drawn distance.
const RING_M: f64 = 1.5;
/// Lateral distance from the ego's path within which traffic shares its direction.
const OWN_LANE_M: f64 = 2.0;
/// `strange-heading`: this far off the road's direction, to either side.
const ACROSS_RAD: (f64, f64) = (0.25 * PI, 0.75 * PI);
/// `cut-in`: this far off the road's direction, towards the ego's lane.
const CUT_IN_RAD: (f64, f64) = (8.0 * PI / 180.0, 25.0 * PI / 180.0);
/// `dense-queue`: between bumpers.
const QUEUE_GAP_M: (f64, f64) = (1.0, 3.0);
/// Cars in a queue do not stand exactly behind each other.
const QUEUE_SIDE_M: f64 = 0.15;

impl Placer<'_> {
    /// Position and heading of one attempt.
    pub(super) fn draw_pose(
        &self,
        asset: &Candidate,
        target: &Target,
        draws: &mut Draws,
    ) -> Result<(DVec2, f64), Rejection> {
        let preset = self.recipe.preset;
        if preset.jitters_recorded_poses() && !asset.ego_from_object.is_empty() {
            let recorded = &asset.ego_from_object[draws.below(asset.ego_from_object.len())];
            return Ok(self.jittered(recorded, draws));
        }
        let at = match self.placed.is_empty() || preset != PlacementPreset::DenseQueue {
            true => self.free_place(asset, target, draws)?,
            false => self.place_in_queue(asset, draws),
        };
        let heading = self.draw_heading(asset, at, target, draws);
        Ok((at, heading.ok_or(Rejection::Coverage)?))
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

    /// A point in a free cell at an evenly drawn distance, no nearer than the asset may be shown.
    fn free_place(
        &self,
        asset: &Candidate,
        target: &Target,
        draws: &mut Draws,
    ) -> Result<DVec2, Rejection> {
        let near = target.distance_m[0].max(nearest_m(&asset.coverage));
        let far = target.distance_m[1];
        if near >= far {
            return Err(Rejection::Coverage);
        }
        let distance = draws.uniform(near, far);
        let ring = ((distance - RING_M).max(near), (distance + RING_M).min(far));
        let cells = self.places.between(ring.0, ring.1);
        if cells.is_empty() {
            return Err(Rejection::NoFreePlace);
        }
        let (_, cell) = cells[draws.below(cells.len())];
        let half = self.stage.region.cell_m * 0.5;
        let within = DVec2::new(draws.jitter(half), draws.jitter(half));
        Ok(self.stage.region.centre(cell) + within)
    }

    /// A point before or behind an object of the queue; taken places are rejected as collisions.
    fn place_in_queue(&self, asset: &Candidate, draws: &mut Draws) -> DVec2 {
        let (_, leader) = &self.placed[draws.below(self.placed.len())];
        let gap = draws.uniform(QUEUE_GAP_M.0, QUEUE_GAP_M.1);
        let reach = 0.5 * (leader.size_m.x + asset.size_m.x) + gap;
        let (sin, cos) = libm::sincos(leader.local_from_cuboid.heading_rad());
        let along = match draws.chance(0.5) {
            true => reach,
            false => -reach,
        };
        let aside = draws.jitter(QUEUE_SIDE_M);
        leader.local_from_cuboid.translation_m.truncate()
            + DVec2::new(cos, sin) * along
            + DVec2::new(-sin, cos) * aside
    }

    /// A heading that is wanted and shows an observed side; `None` if there is none.
    fn draw_heading(
        &self,
        asset: &Candidate,
        at: DVec2,
        target: &Target,
        draws: &mut Draws,
    ) -> Option<f64> {
        let sight = at - self.local_from_camera.translation_m.truncate();
        let line = libm::atan2(sight.y, sight.x);
        let wanted = match &target.headings {
            Some(camera_relative) => camera_relative.clone(),
            None => self.preset_headings(asset, at).turned(-line),
        };
        let observed = observed_headings(&asset.coverage, self.recipe.coverage_slack_rad);
        let seen = match self.recipe.preset.jitters_recorded_poses() {
            true => wanted,
            false => wanted.intersect(&observed),
        };
        Some(wrap(seen.draw(draws)? + line))
    }

    /// The headings that the preset wants at a place.
    fn preset_headings(&self, asset: &Candidate, at: DVec2) -> Arcs {
        let place = Road::new(self.stage.recording).at(at);
        let road = place.heading_rad;
        match self.recipe.preset {
            PlacementPreset::StrangeHeading => {
                let half = 0.5 * (ACROSS_RAD.1 - ACROSS_RAD.0);
                let middle = 0.5 * (ACROSS_RAD.1 + ACROSS_RAD.0);
                Arcs::around([(road + middle, half), (road - middle, half)].into_iter())
            }
            PlacementPreset::CutIn => {
                let half = 0.5 * (CUT_IN_RAD.1 - CUT_IN_RAD.0);
                let inwards = -place.lateral_m.signum() * 0.5 * (CUT_IN_RAD.1 + CUT_IN_RAD.0);
                Arcs::around([(road + inwards, half)].into_iter())
            }
            PlacementPreset::DenseQueue if !self.placed.is_empty() => {
                let (_, leader) = &self.placed[0];
                let ahead = leader.local_from_cuboid.heading_rad();
                let with_road = wrap(ahead - road).abs() < 0.5 * PI;
                let along = if with_road { road } else { road + PI };
                Arcs::around([(along, self.recipe.jitter.heading_rad)].into_iter())
            }
            // People walk where they like.
            _ if !asset.class.is_vehicle() => Arcs::all(),
            _ => self.along_road(&place),
        }
    }

    /// Both directions of the road, one only in the ego's own lane.
    fn along_road(&self, place: &RoadPlace) -> Arcs {
        let half = self.recipe.jitter.heading_rad;
        let both = place.lateral_m.abs() > OWN_LANE_M;
        let turns = [Some(0.0), both.then_some(PI)];
        let turns = turns.into_iter().flatten();
        Arcs::around(turns.map(|turn| (place.heading_rad + turn, half)))
    }
}
