//! Whether a pose shows a side of the object that was observed.

use std::f64::consts::{PI, TAU};

use glam::DVec3;

use crate::quality::ViewCoverage;

/// Nearest distance at which an object is shown, as a fraction of the nearest at which it was seen: larger it only gets blurred.
const NEAREST_OF_SEEN: f64 = 0.7;

/// Whether a camera at `eye` (cuboid frame) sees the object from within `slack_rad` of an observed side and elevation, and not
/// from much nearer than it was ever seen.
pub(super) fn covers(coverage: &ViewCoverage, eye: DVec3, slack_rad: f64) -> bool {
    if eye.length() < NEAREST_OF_SEEN * coverage.distance_min_m {
        return false;
    }
    let elevation = libm::atan2(eye.z, eye.truncate().length());
    elevation >= coverage.elevation_min_rad - slack_rad
        && elevation <= coverage.elevation_max_rad + slack_rad
        && azimuth_gap_rad(coverage, libm::atan2(eye.y, eye.x)) <= slack_rad
}

/// Angle from an azimuth to the nearest observed one; infinite if there is none.
///
/// The cameras' own azimuths count, not their sectors: a car followed from straight behind shows none of its side, and 15
/// degrees further round the side fills the view.
fn azimuth_gap_rad(coverage: &ViewCoverage, azimuth: f64) -> f64 {
    let gaps = coverage.azimuths_rad.iter();
    gaps.map(|seen| wrap(azimuth - seen).abs())
        .fold(f64::INFINITY, f64::min)
}

/// Wraps an angle to (-pi, pi].
pub(super) fn wrap(angle_rad: f64) -> f64 {
    angle_rad - TAU * libm::ceil((angle_rad - PI) / TAU)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Rigid;
    use glam::DQuat;

    fn eye(azimuth_deg: f64) -> DVec3 {
        let (sin, cos) = libm::sincos(azimuth_deg.to_radians());
        DVec3::new(10.0 * cos, 10.0 * sin, 1.0)
    }

    fn seen_from(azimuths_deg: &[f64], symmetric: bool) -> ViewCoverage {
        let cameras: Vec<_> = azimuths_deg
            .iter()
            .map(|a| Rigid::new(DQuat::IDENTITY, eye(*a)))
            .collect();
        ViewCoverage::of_cameras(&cameras, symmetric)
    }

    #[test]
    fn covers_what_was_seen_and_the_slack_around_it() {
        let seen = seen_from(&[187.0, 200.0], false);
        let slack = 20f64.to_radians();
        for (azimuth, expected) in [
            (190.0, true),
            (168.0, true),
            (166.0, false),
            (219.0, true),
            (221.0, false),
            (10.0, false),
        ] {
            assert_eq!(covers(&seen, eye(azimuth), slack), expected, "{azimuth}");
        }
        let above = DVec3::new(-10.0, -1.0, 8.0);
        assert!(!covers(&seen, above, slack));
        assert!(!covers(&ViewCoverage::default(), eye(0.0), 0.3));
    }

    #[test]
    fn the_mirror_image_counts_only_for_symmetric_objects() {
        assert!(covers(&seen_from(&[100.0], true), eye(-100.0), 0.0));
        assert!(!covers(&seen_from(&[100.0], false), eye(-100.0), 0.3));
    }

    #[test]
    fn wrap_stays_in_range() {
        for (angle, expected) in [(3.5 * PI, -0.5 * PI), (PI, PI), (-PI, PI), (0.2, 0.2)] {
            assert!((wrap(angle) - expected).abs() < 1e-12, "{angle}");
        }
    }
}
