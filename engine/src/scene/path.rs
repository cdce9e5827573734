//! The line the recording vehicle drove, and a straight continuation ahead of it.

use glam::{DVec2, DVec3};

use super::recording::Recording;

/// Positions of the first camera in driving order, then points straight ahead of the last.
pub(super) struct DrivenPath {
    points: Vec<DVec3>,
    /// How many of `points` were driven.
    pub(super) driven: usize,
}

/// Where a point lies beside the path.
#[derive(Clone, Copy, Debug)]
pub(super) struct Beside {
    pub(super) distance_m: f64,
    /// Nearest point of the path.
    pub(super) foot: DVec2,
    /// The point lies before the path's start or past its end.
    pub(super) beyond: bool,
}

/// Standing still adds no points.
const MIN_STEP_M: f64 = 0.25;
/// The slope is that of so much of the path before and after: over less it is the nodding of the ego vehicle.
const SLOPE_REACH_M: f64 = 2.5;

impl DrivenPath {
    /// `None` without frames.
    pub(super) fn new(recording: &Recording, ahead_m: f64) -> Option<Self> {
        let camera_id = &recording.cameras.first()?.camera_id;
        let mut points: Vec<DVec3> = Vec::new();
        let mut last_forward = DVec3::X;
        for frame in recording
            .frames
            .iter()
            .filter(|f| f.camera_id == *camera_id)
        {
            let at = frame.local_from_camera.translation_m;
            if points
                .last()
                .is_none_or(|p| (*p - at).length() >= MIN_STEP_M)
            {
                points.push(at);
            }
            last_forward = frame.local_from_ego.direction(DVec3::X);
        }
        let last = *points.last()?;
        let driven = points.len();
        let steps = libm::floor(ahead_m) as i32;
        points.extend((1..=steps).map(|i| last + last_forward * f64::from(i)));
        Some(Self { points, driven })
    }

    pub(super) fn points(&self) -> &[DVec3] {
        &self.points
    }

    pub(super) fn is_beside(&self, p: DVec2, within_m: f64) -> bool {
        let beside = self.beside(p);
        !beside.beyond && beside.distance_m <= within_m
    }

    /// Rise of the path per metre beside a point, as a vector along its course; none across it.
    pub(super) fn slope_beside(&self, p: DVec2) -> DVec2 {
        let foot = self.beside(p).foot;
        let from_foot = |i: usize| (self.points[i].truncate() - foot).length();
        let all = 0..self.points.len();
        let nearest = all.min_by(|a, b| from_foot(*a).total_cmp(&from_foot(*b)));
        let nearest = nearest.unwrap_or(0);
        let is_far = |i: &usize| from_foot(*i) >= SLOPE_REACH_M;
        let first = (0..nearest).rev().find(is_far).unwrap_or(0);
        let last = (nearest..self.points.len()).find(is_far);
        let last = last.unwrap_or(self.points.len() - 1);
        let along = self.points[last] - self.points[first];
        let flat = along.truncate();
        if flat.length() < SLOPE_REACH_M {
            return DVec2::ZERO;
        }
        flat * (along.z / flat.length_squared())
    }

    pub(super) fn beside(&self, p: DVec2) -> Beside {
        let last = self.points.len().saturating_sub(2);
        self.points
            .windows(2)
            .enumerate()
            .map(|(i, s)| foot_on(s[0], s[1], p, i == 0, i == last))
            .min_by(|a, b| a.distance_m.total_cmp(&b.distance_m))
            .unwrap_or(Beside {
                distance_m: (self.points[0].truncate() - p).length(),
                foot: self.points[0].truncate(),
                beyond: true,
            })
    }
}

fn foot_on(a: DVec3, b: DVec3, p: DVec2, first: bool, last: bool) -> Beside {
    let along = (b - a).truncate();
    let fraction = (p - a.truncate()).dot(along) / along.length_squared().max(f64::MIN_POSITIVE);
    let foot = a.lerp(b, fraction.clamp(0.0, 1.0));
    Beside {
        distance_m: (foot.truncate() - p).length(),
        foot: foot.truncate(),
        beyond: (first && fraction < 0.0) || (last && fraction > 1.0),
    }
}

#[cfg(test)]
mod tests {
    use super::super::box_world::drive;
    use super::*;

    #[test]
    fn the_slope_beside_a_path_is_along_it_alone() {
        let path = DrivenPath::new(&drive(0.05, 20, 1.0), 10.0).unwrap();
        for p in [
            DVec2::new(0.0, 3.0),
            DVec2::new(9.3, -4.0),
            DVec2::new(25.0, 1.0),
        ] {
            let off = path.slope_beside(p) - DVec2::new(0.05, 0.0);
            assert!(off.length() < 1e-9, "{off} at {p}");
        }
        // A second, higher pass over the same place does not count as a slope.
        let mut twice = drive(0.0, 20, 1.0);
        for again in drive(0.0, 20, 1.0).frames {
            let mut frame = again;
            frame.local_from_camera.translation_m += DVec3::new(0.2, 0.3, 0.1);
            twice.frames.push(frame);
        }
        let path = DrivenPath::new(&twice, 0.0).unwrap();
        assert!(path.slope_beside(DVec2::new(9.0, 3.0)).length() < 1e-9);
        // Without a way there is no slope.
        let stood = DrivenPath::new(&drive(0.05, 1, 1.0), 0.0).unwrap();
        assert_eq!(stood.slope_beside(DVec2::new(0.0, 1.0)), DVec2::ZERO);
    }
}
