//! The direction of the road, taken from the driven path.

use glam::DVec2;

use super::recording::Recording;

/// The driven path as a direction for every place.
#[derive(Clone, Copy, Debug)]
pub(super) struct Road<'a> {
    recording: &'a Recording,
}

/// A place beside the driven path.
#[derive(Clone, Copy, Debug)]
pub(super) struct RoadPlace {
    /// Heading of the path where it passes nearest.
    pub(super) heading_rad: f64,
    /// Distance left of the path.
    pub(super) lateral_m: f64,
}

impl<'a> Road<'a> {
    pub(super) fn new(recording: &'a Recording) -> Self {
        Self { recording }
    }

    /// Of the nearest recorded ego pose; straight along x without one.
    pub(super) fn at(&self, at: DVec2) -> RoadPlace {
        let frames = self.recording.frames.iter();
        let distance =
            |ego: &crate::camera::Rigid| (ego.translation_m.truncate() - at).length_squared();
        let nearest = frames
            .map(|frame| &frame.local_from_ego)
            .min_by(|a, b| distance(a).total_cmp(&distance(b)));
        let Some(ego) = nearest else {
            return RoadPlace {
                heading_rad: 0.0,
                lateral_m: at.y,
            };
        };
        RoadPlace {
            heading_rad: ego.heading_rad(),
            lateral_m: ego.inverse().point(at.extend(ego.translation_m.z)).y,
        }
    }
}
