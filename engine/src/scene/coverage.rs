//! Whether a pose shows a side of the object that was observed.

use std::f64::consts::PI;

use glam::DVec3;

use super::arcs::{Arcs, wrap};
use crate::quality::ViewCoverage;

/// Nearest distance at which an object is shown, as a fraction of the nearest at which it was seen: larger it only gets blurred.
const NEAREST_OF_SEEN: f64 = 0.7;

/// Whether a camera at `eye` (cuboid frame) sees the object from within `slack_rad` of an observed side and elevation, and not
/// from much nearer than it was ever seen.
pub(super) fn covers(coverage: &ViewCoverage, eye: DVec3, slack_rad: f64) -> bool {
    if eye.length() < nearest_m(coverage) {
        return false;
    }
    let elevation = libm::atan2(eye.z, eye.truncate().length());
    elevation >= coverage.elevation_min_rad - slack_rad
        && elevation <= coverage.elevation_max_rad + slack_rad
        && azimuth_gap_rad(coverage, libm::atan2(eye.y, eye.x)) <= slack_rad
}

/// Nearest distance at which the object may be shown.
pub(super) fn nearest_m(coverage: &ViewCoverage) -> f64 {
    NEAREST_OF_SEEN * coverage.distance_min_m
}

/// The camera-relative headings in which the object shows an observed side.
///
/// A camera in direction `line` behind an object of heading `psi` stands at azimuth `pi - (psi - line)` in the object's frame.
pub(super) fn observed_headings(coverage: &ViewCoverage, slack_rad: f64) -> Arcs {
    let azimuths = coverage.azimuths_rad.iter();
    Arcs::around(azimuths.map(|azimuth| (PI - azimuth, slack_rad)))
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
    fn observed_headings_are_those_that_are_covered() {
        let seen = seen_from(&[187.0, 100.0, -20.0], false);
        let slack = 8f64.to_radians();
        let headings = observed_headings(&seen, slack);
        // A camera at the origin looks along +x at an object 10 m ahead.
        for degrees in (-180..180).step_by(3) {
            let heading = f64::from(degrees).to_radians() + 0.01;
            let pose = Rigid::from_heading(heading, DVec3::new(10.0, 0.0, 0.0));
            let eye = pose.inverse().point(DVec3::new(0.0, 0.0, 1.0));
            assert_eq!(
                covers(&seen, eye, slack),
                headings.contains(heading),
                "{degrees}"
            );
        }
    }
}
