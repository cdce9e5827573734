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
