//! The cars of a street and where each is at any time.

use backlot_engine::camera::Rigid;
use glam::DVec3;

use super::car::CarDesign;
use super::config::StreetConfig;
use super::noise::unit;

/// Where one instance of a track stands. The same track may appear several times in a rendered scene.
#[derive(Clone, Debug, PartialEq)]
pub struct ActorPose {
    pub track_id: String,
    /// Pose of the cuboid's centre; x forward, y left, z up.
    pub world_from_cuboid: Rigid,
}

/// One car of the street.
#[derive(Clone, Debug)]
pub(super) struct Actor {
    pub(super) track_id: String,
    pub(super) design: CarDesign,
    pub(super) motion: Motion,
}

/// A constant-speed drive along the street; parked cars have speed 0.
#[derive(Clone, Copy, Debug)]
pub(super) struct Motion {
    x_m: f64,
    y_m: f64,
    heading_rad: f64,
    /// Along +x of the world.
    velocity_m_s: f64,
    /// Lateral drift of the driver within the lane.
    sway_m: f64,
}

/// Centre of the right lane and of the left lane, and of the parking strips.
pub(super) const LANE_Y_M: f64 = 1.75;
const PARKING_Y_M: f64 = 4.62;
/// Wave length of the sway of moving cars along the street.
const SWAY_LENGTH_M: f64 = 55.0;

impl Motion {
    /// world_from_cuboid at `time_s` after the first frame.
    fn pose(&self, time_s: f64, height_m: f64) -> Rigid {
        let x = self.x_m + self.velocity_m_s * time_s;
        let wave = std::f64::consts::TAU / SWAY_LENGTH_M;
        let phase = wave * x + self.x_m;
        let y = self.y_m + self.sway_m * libm::sin(phase);
        let slope = self.sway_m * wave * libm::cos(phase);
        Rigid::from_heading(
            self.heading_rad + libm::atan(slope),
            DVec3::new(x, y, 0.5 * height_m),
        )
    }
}

impl Actor {
    pub(super) fn world_from_cuboid(&self, time_s: f64) -> Rigid {
        self.motion.pose(time_s, f64::from(self.design.size_m.z))
    }

    /// Parked cars alternate between the kerbs; the lead car and oncoming cars follow.
    pub(super) fn draw_all(config: &StreetConfig) -> Vec<Self> {
        let seed = config.seed as u32;
        let parked = (0..config.parked_cars).map(|i| Self {
            track_id: format!("parked-{i:02}"),
            design: CarDesign::draw(seed, i),
            motion: parked_motion(seed, i),
        });
        let moving = (0..config.moving_cars).map(|i| Self {
            track_id: format!("moving-{i:02}"),
            design: CarDesign::draw(seed.wrapping_add(5), config.parked_cars + i),
            motion: moving_motion(i, config.ego_speed_m_s),
        });
        parked.chain(moving).collect()
    }
}

fn parked_motion(seed: u32, index: u32) -> Motion {
    let jitter = |k: u32, reach: f64| reach * (2.0 * f64::from(unit(seed, index, 40 + k)) - 1.0);
    let right = index.is_multiple_of(2);
    let slot = f64::from(index / 2);
    // Gaps of one to two car lengths stay free for inserted cars.
    let x_m = if right {
        13.0 + 15.5 * slot
    } else {
        19.5 + 16.5 * slot
    } + jitter(0, 1.6);
    let side = if right { -1.0 } else { 1.0 };
    // One car in five is parked against the direction of its lane.
    let reversed = index % 5 == 3;
    let along = if right == reversed {
        std::f64::consts::PI
    } else {
        0.0
    };
    Motion {
        x_m,
        y_m: side * PARKING_Y_M + jitter(1, 0.12),
        heading_rad: along + jitter(2, 0.05),
        velocity_m_s: 0.0,
        sway_m: 0.0,
    }
}

fn moving_motion(index: u32, ego_speed_m_s: f64) -> Motion {
    if index == 0 {
        return Motion {
            x_m: 15.0,
            y_m: -LANE_Y_M,
            heading_rad: 0.0,
            velocity_m_s: 1.12 * ego_speed_m_s,
            sway_m: 0.22,
        };
    }
    Motion {
        x_m: 36.0 + 46.0 * f64::from(index - 1),
        y_m: LANE_Y_M + 0.1,
        heading_rad: std::f64::consts::PI,
        velocity_m_s: -0.75 * ego_speed_m_s,
        sway_m: 0.15,
    }
}
