//! A street as a world that can be driven through, scanned and photographed.

use backlot_engine::camera::{Camera, Distortion, Rigid};
use glam::{DMat3, DQuat, DVec2, DVec3};

use super::actors::{Actor, ActorPose};
use super::bvh::Mesh;
use super::config::{Error, StreetConfig};
use super::render::{ExactFrame, RenderOptions, ShadowCasters, View, render};
use super::scene::{Instance, Scene};
use super::sky;
use super::street::Street;

/// A generated street with its cars and the drive through it.
///
/// World frame: x along the street, y left, z up, metres; the road is the plane z = 0.
#[derive(Debug)]
pub struct StreetWorld {
    pub(super) config: StreetConfig,
    pub(super) actors: Vec<Actor>,
    street: Street,
    meshes: Vec<Mesh>,
}

/// Time of the first frame on the log's clock.
pub(super) const START_NS: i64 = 1_700_000_000_000_000_000;
/// Ego frame origin above the road: the middle of the rear axle.
const EGO_HEIGHT_M: f64 = 0.33;
/// Where the camera sits in the ego frame.
const CAMERA_IN_EGO_M: DVec3 = DVec3::new(1.7, 0.0, 1.6 - EGO_HEIGHT_M);
const CAMERA_PITCH_DOWN_RAD: f64 = 0.025;
/// Lateral wobble of the ego vehicle, so that the trajectory is not a line.
const WOBBLE_M: f64 = 0.35;
const WOBBLE_LENGTH_M: f64 = 47.0;

impl StreetWorld {
    /// Lays out the street of a configuration.
    ///
    /// # Errors
    /// [`Error::OutOfRange`] if the configuration is not valid.
    pub fn new(config: &StreetConfig) -> Result<Self, Error> {
        config.validate()?;
        let actors = Actor::draw_all(config);
        Ok(Self {
            config: config.clone(),
            meshes: actors.iter().map(|actor| actor.design.mesh()).collect(),
            actors,
            street: Street::new(config.seed as u32, config.travel_m),
        })
    }

    pub fn config(&self) -> &StreetConfig {
        &self.config
    }

    /// Poses of all cars at a time on the log's clock, in the order of the log's tracks.
    pub fn actors_at(&self, timestamp_ns: i64) -> Vec<ActorPose> {
        let time_s = seconds(timestamp_ns);
        self.actors
            .iter()
            .map(|actor| ActorPose {
                track_id: actor.track_id.clone(),
                world_from_cuboid: actor.world_from_cuboid(time_s),
            })
            .collect()
    }

    /// Full extents of a car's cuboid (length, width, height).
    ///
    /// # Errors
    /// [`Error::UnknownTrack`].
    pub fn size_m(&self, track_id: &str) -> Result<DVec3, Error> {
        Ok(self.actors[self.track_index(track_id)?]
            .design
            .size_m
            .as_dvec3())
    }

    /// The exact image of `view` with exactly the given cars.
    ///
    /// # Errors
    /// [`Error::UnknownTrack`] if an actor is not a car of this street.
    pub fn render(
        &self,
        view: &View,
        actors: &[ActorPose],
        options: &RenderOptions,
    ) -> Result<ExactFrame, Error> {
        let scene = self.scene(actors, &options.shadow_casters)?;
        Ok(render(&scene, view, options.supersample, self.seed()))
    }

    /// The front camera of the log.
    pub fn camera(&self) -> Camera {
        let (width, height) = (self.config.width, self.config.height);
        let focal = 0.5 * f64::from(width) / libm::tan(0.5 * self.config.horizontal_fov_rad);
        Camera {
            width,
            height,
            focal_px: DVec2::splat(focal),
            principal_px: DVec2::new(0.5 * f64::from(width), 0.5 * f64::from(height)),
            distortion: Distortion::None,
        }
    }

    /// Mounting of the camera: z forward and slightly down, x right, y down.
    pub fn ego_from_camera(&self) -> Rigid {
        let axes = DMat3::from_cols(DVec3::NEG_Y, DVec3::NEG_Z, DVec3::X);
        let pitch = DQuat::from_rotation_y(CAMERA_PITCH_DOWN_RAD);
        Rigid::new(
            (pitch * DQuat::from_mat3(&axes)).normalize(),
            CAMERA_IN_EGO_M,
        )
    }

    /// True ego pose at a time on the log's clock.
    pub fn world_from_ego(&self, timestamp_ns: i64) -> Rigid {
        let x = self.config.ego_speed_m_s * seconds(timestamp_ns);
        let wave = std::f64::consts::TAU / WOBBLE_LENGTH_M;
        let y = -super::actors::LANE_Y_M + WOBBLE_M * libm::sin(wave * x);
        let heading = libm::atan(WOBBLE_M * wave * libm::cos(wave * x));
        // The body pitches and rolls a little, as on a real road.
        let pitch = 0.004 * libm::sin(0.7 * x + 0.4);
        let roll = 0.005 * libm::sin(0.45 * x);
        let rotation = DQuat::from_rotation_z(heading)
            * DQuat::from_rotation_y(pitch)
            * DQuat::from_rotation_x(roll);
        Rigid::new(rotation, DVec3::new(x, y, EGO_HEIGHT_M))
    }

    /// Unit vector from the ground towards the sun.
    pub fn sun_direction_world(&self) -> DVec3 {
        sky::sun_direction()
    }

    pub(super) fn seed(&self) -> u32 {
        self.config.seed as u32
    }

    pub(super) fn scene(
        &self,
        actors: &[ActorPose],
        casters: &ShadowCasters,
    ) -> Result<Scene<'_>, Error> {
        let instances = actors
            .iter()
            .enumerate()
            .map(|(i, pose)| {
                let index = self.track_index(&pose.track_id)?;
                let design = &self.actors[index].design;
                Ok(Instance::new(
                    &self.meshes[index],
                    design,
                    &pose.world_from_cuboid,
                    casters.includes(i),
                ))
            })
            .collect::<Result<_, Error>>()?;
        Ok(Scene {
            street: &self.street,
            instances,
        })
    }

    fn track_index(&self, track_id: &str) -> Result<usize, Error> {
        let found = self
            .actors
            .iter()
            .position(|actor| actor.track_id == track_id);
        found.ok_or_else(|| Error::UnknownTrack {
            track_id: track_id.to_owned(),
        })
    }
}

/// Seconds after the first frame.
pub(super) fn seconds(timestamp_ns: i64) -> f64 {
    (timestamp_ns - START_NS) as f64 * 1e-9
}
