//! Given paths of objects over time.

use glam::{DVec2, DVec3};
use serde::{Deserialize, Serialize};

use super::arcs::wrap;
use crate::camera::Rigid;
use crate::{Error, Result};

/// Where an object is at one time. Its height, pitch and roll come from the ground.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Waypoint {
    /// Seconds after the sample's first frame.
    pub time_s: f64,
    /// Only x and y are used.
    pub position_m: DVec3,
    /// From x towards y.
    pub heading_rad: f64,
}

/// Waypoints in the order of their times: straight and turning evenly between them, standing still before the first and after the last.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Trajectory {
    pub waypoints: Vec<Waypoint>,
}

/// Waypoints of one trajectory.
pub const MAX_WAYPOINTS: usize = 1000;

impl Trajectory {
    /// Checks that there are waypoints, finite and in order; `field` names the trajectory.
    ///
    /// # Errors
    /// [`Error::Invalid`] naming the waypoint.
    pub fn validate(&self, field: &str) -> Result<()> {
        let count = self.waypoints.len();
        if count == 0 || count > MAX_WAYPOINTS {
            return Err(Error::invalid(format!(
                "{field}: {count} waypoints, not 1 to {MAX_WAYPOINTS}"
            )));
        }
        for (i, point) in self.waypoints.iter().enumerate() {
            let finite = point.time_s.is_finite()
                && point.position_m.is_finite()
                && point.heading_rad.is_finite();
            if !finite {
                return Err(Error::invalid(format!(
                    "{field}: waypoint {i} is not finite"
                )));
            }
            if i > 0 && point.time_s <= self.waypoints[i - 1].time_s {
                return Err(Error::invalid(format!(
                    "{field}: waypoint {i} is not later than the one before it"
                )));
            }
        }
        Ok(())
    }

    /// Position and heading at a time.
    ///
    /// # Panics
    /// Without waypoints.
    pub fn at(&self, time_s: f64) -> (DVec2, f64) {
        let next = self.waypoints.partition_point(|w| w.time_s <= time_s);
        let before = &self.waypoints[next.saturating_sub(1)];
        let Some(after) = self.waypoints.get(next).filter(|_| next > 0) else {
            return (before.position_m.truncate(), before.heading_rad);
        };
        let fraction = (time_s - before.time_s) / (after.time_s - before.time_s);
        let turn = wrap(after.heading_rad - before.heading_rad);
        (
            before
                .position_m
                .lerp(after.position_m, fraction)
                .truncate(),
            wrap(before.heading_rad + fraction * turn),
        )
    }

    /// The same path in another frame whose z axis is up as well.
    pub fn transformed(&self, target_from_source: &Rigid) -> Self {
        let waypoints = self.waypoints.iter().map(|w| {
            let (sin, cos) = libm::sincos(w.heading_rad);
            let forward = target_from_source.direction(DVec3::new(cos, sin, 0.0));
            Waypoint {
                time_s: w.time_s,
                position_m: target_from_source.point(w.position_m),
                heading_rad: libm::atan2(forward.y, forward.x),
            }
        });
        Self {
            waypoints: waypoints.collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn path(points: &[(f64, f64, f64, f64)]) -> Trajectory {
        let waypoints = points.iter().map(|&(time_s, x, y, heading_rad)| Waypoint {
            time_s,
            position_m: DVec3::new(x, y, 0.0),
            heading_rad,
        });
        Trajectory {
            waypoints: waypoints.collect(),
        }
    }

    #[test]
    fn between_waypoints_it_moves_evenly_and_turns_the_short_way() {
        let path = path(&[(1.0, 0.0, 0.0, 3.0), (3.0, 4.0, 2.0, -3.0)]);
        assert_eq!(path.at(0.0), (DVec2::ZERO, 3.0));
        assert_eq!(path.at(9.0), (DVec2::new(4.0, 2.0), -3.0));
        let (at, heading) = path.at(2.0);
        assert!((at - DVec2::new(2.0, 1.0)).length() < 1e-12);
        assert!(
            (heading.abs() - std::f64::consts::PI).abs() < 1e-9,
            "{heading}"
        );
    }

    #[test]
    fn a_path_in_another_frame_is_the_same_path() {
        let path = path(&[(0.0, 1.0, 2.0, 0.4), (1.0, 3.0, 2.0, 0.9)]);
        let frame = Rigid::from_heading(0.5, DVec3::new(10.0, -3.0, 2.0));
        let moved = path.transformed(&frame);
        let (at, heading) = moved.at(0.5);
        let expected = frame.point(DVec3::new(2.0, 2.0, 0.0)).truncate();
        assert!((at - expected).length() < 1e-12);
        assert!((heading - (0.65 + 0.5)).abs() < 1e-12);
        assert_ne!(path.at(0.5).0, at, "another frame has other coordinates");
    }

    #[test]
    fn bad_waypoints_are_named() {
        let says = |path: Trajectory| path.validate("follow").unwrap_err().to_string();
        assert!(says(path(&[])).contains("follow: 0 waypoints"));
        let twice = path(&[(0.0, 0.0, 0.0, 0.0), (0.0, 1.0, 0.0, 0.0)]);
        assert!(says(twice).contains("waypoint 1 is not later"));
        let nan = path(&[(0.0, f64::NAN, 0.0, 0.0)]);
        assert!(says(nan).contains("waypoint 0 is not finite"));
    }
}
