//! A drive through the street as a driving log.

use std::io::Cursor;

use backlot_engine::camera::Rigid;
use backlot_proto::v1;
use glam::{DQuat, DVec3};
use image::{ImageBuffer, ImageFormat, Luma, Pixel, PixelWithColorType, Rgb};
use rayon::prelude::*;

use super::actors::Actor;
use super::config::{DepthRecording, Error};
use super::depth::depth_units;
use super::noise::{gaussian, hash, unit};
use super::render::{ExactFrame, RenderOptions, View};
use super::world::{START_NS, StreetWorld};
use crate::geometry::{rigid_to_wire, vector_to_wire};
use crate::read_log::ReadLog;

const CAMERA_ID: &str = "front";
const LIDAR_ID: &str = "roof";
/// Ego poses come at 100 Hz: linear interpolation between them is exact to 0.02 mm.
const POSE_PERIOD_NS: i64 = 10_000_000;
/// Track states come at 10 Hz, between the frames.
const STATE_PERIOD_NS: i64 = 100_000_000;
const STATE_OFFSET_NS: i64 = -137_000_000;
/// The first sweep starts before the first frame, so that frames lie between sweeps.
const SWEEP_OFFSET_NS: i64 = -41_000_000;
/// Trajectory and tracks reach this far beyond the first and last frame.
const MARGIN_NS: i64 = 300_000_000;

impl StreetWorld {
    /// Time of each camera frame.
    pub fn frame_timestamps_ns(&self) -> Vec<i64> {
        let period_ns = self.config.frame_period_s() * 1e9;
        (0..self.config.frames)
            .map(|i| START_NS + (f64::from(i) * period_ns).round() as i64)
            .collect()
    }

    /// The true view of a frame.
    pub fn view_at(&self, timestamp_ns: i64) -> View {
        View {
            camera: self.camera(),
            world_from_camera: self.world_from_ego(timestamp_ns) * self.ego_from_camera(),
        }
    }

    /// The exact image of the log at a time, with all cars where they are then.
    ///
    /// # Errors
    /// Those of [`StreetWorld::render`].
    pub fn frame_at(&self, timestamp_ns: i64) -> Result<ExactFrame, Error> {
        let options = RenderOptions {
            supersample: self.config.supersample,
            ..RenderOptions::default()
        };
        self.render(
            &self.view_at(timestamp_ns),
            &self.actors_at(timestamp_ns),
            &options,
        )
    }

    /// Drives through the street and records it.
    ///
    /// # Errors
    /// [`Error::Encode`] if an image does not encode.
    pub fn read_log(&self) -> Result<ReadLog, Error> {
        let mut log = ReadLog::default();
        let timestamps = self.frame_timestamps_ns();
        let last_ns = *timestamps.last().unwrap_or(&START_NS);
        let frames = self.record_frames(&mut log, &timestamps)?;
        let sweeps = match self.config.depth {
            DepthRecording::Lidar => self.record_sweeps(&mut log, last_ns)?,
            _ => Vec::new(),
        };
        let sfm_points = match self.config.depth {
            DepthRecording::Points => Some(self.record_points(&mut log, &timestamps)?),
            _ => None,
        };
        log.drive_log = v1::DriveLog {
            dataset: "generated".to_owned(),
            synthetic: true,
            local_from_world: Some(rigid_to_wire(&Rigid::IDENTITY)),
            cameras: vec![self.wire_camera()],
            world_from_ego: self.record_trajectory(last_ns),
            frames,
            sweeps,
            sfm_points,
            tracks: self
                .actors
                .iter()
                .map(|actor| record_track(actor, last_ns))
                .collect(),
            notes: self.notes(),
            sun_direction_world: Some(vector_to_wire(self.sun_direction_world())),
            ..v1::DriveLog::default()
        };
        Ok(log)
    }

    fn record_frames(
        &self,
        log: &mut ReadLog,
        timestamps: &[i64],
    ) -> Result<Vec<v1::CameraFrame>, Error> {
        // One frame at a time keeps memory flat; each is parallel inside.
        let mut frames = Vec::with_capacity(timestamps.len());
        for (index, &timestamp_ns) in timestamps.iter().enumerate() {
            let exact = self.frame_at(timestamp_ns)?;
            let mask = noisy_mask(
                &exact,
                self.config.mask_edge_noise,
                hash(self.seed(), index as u32, 71),
            );
            let sky = exact
                .sky
                .iter()
                .map(|&sky| if sky { 255_u8 } else { 0 })
                .collect();
            let (width, height) = (exact.width, exact.height);
            let depth_map = match self.config.depth {
                DepthRecording::Maps => {
                    let (units, unit_m) = depth_units(&exact, index as u32, self.seed());
                    Some(v1::DepthMap {
                        image: Some(log.add_bytes(png::<Luma<u16>>(width, height, units)?)),
                        unit_m,
                        kind: v1::DepthMapKind::Monocular.into(),
                        weight: 0.0,
                    })
                }
                _ => None,
            };
            frames.push(v1::CameraFrame {
                camera_id: CAMERA_ID.to_owned(),
                frame_index: index as u32,
                timestamp_ns,
                image: Some(log.add_bytes(png::<Rgb<u8>>(width, height, exact.rgb8)?)),
                instance_mask: Some(log.add_bytes(png::<Luma<u16>>(width, height, mask)?)),
                sky_mask: Some(log.add_bytes(png::<Luma<u8>>(width, height, sky)?)),
                depth_map,
                ..v1::CameraFrame::default()
            });
        }
        Ok(frames)
    }

    fn record_sweeps(&self, log: &mut ReadLog, last_ns: i64) -> Result<Vec<v1::LidarSweep>, Error> {
        let turn_ns = (self.config.lidar.turn_s * 1e9).round() as i64;
        let starts = (0_i64..)
            .map(|i| START_NS + SWEEP_OFFSET_NS + i * turn_ns)
            .take_while(|&t| t <= last_ns);
        let mut sweeps = Vec::new();
        for (index, timestamp_ns) in starts.enumerate() {
            let points = self.scan(timestamp_ns, index as u32)?;
            let bytes: Vec<u8> = points
                .into_iter()
                .flat_map(|point| point.to_bytes())
                .collect();
            sweeps.push(v1::LidarSweep {
                lidar_id: LIDAR_ID.to_owned(),
                timestamp_ns,
                ego_from_lidar: Some(rigid_to_wire(&self.ego_from_lidar())),
                points: Some(log.add_bytes(bytes)),
                format: v1::PointFormat::XyzitF32.into(),
            });
        }
        Ok(sweeps)
    }

    fn record_points(&self, log: &mut ReadLog, timestamps: &[i64]) -> Result<v1::SfmPoints, Error> {
        let content = self.triangulate(timestamps)?;
        Ok(v1::SfmPoints {
            points: Some(log.add_bytes(content.points)),
            observations: Some(log.add_bytes(content.observations)),
            weight: 0.0,
        })
    }

    fn record_trajectory(&self, last_ns: i64) -> Vec<v1::TimedPose> {
        let noise = self.config.pose_noise;
        let times = (0_i64..).map(|i| START_NS - MARGIN_NS + i * POSE_PERIOD_NS);
        times
            .take_while(|&t| t <= last_ns + MARGIN_NS)
            .enumerate()
            .map(|(i, timestamp_ns)| {
                let draw = |axis: u32| gaussian(i as u32, self.seed(), 100 + axis);
                let shift = DVec3::new(draw(0), draw(1), draw(2)) * noise.translation_m;
                let turn = DVec3::new(draw(3), draw(4), draw(5)) * noise.rotation_rad;
                let true_pose = self.world_from_ego(timestamp_ns);
                let pose = Rigid::new(
                    (true_pose.rotation * DQuat::from_scaled_axis(turn)).normalize(),
                    true_pose.translation_m + shift,
                );
                v1::TimedPose {
                    timestamp_ns,
                    pose: Some(rigid_to_wire(&pose)),
                }
            })
            .collect()
    }

    fn wire_camera(&self) -> v1::Camera {
        let camera = self.camera();
        v1::Camera {
            camera_id: CAMERA_ID.to_owned(),
            width: camera.width,
            height: camera.height,
            focal_x_px: camera.focal_px.x,
            focal_y_px: camera.focal_px.y,
            principal_x_px: camera.principal_px.x,
            principal_y_px: camera.principal_px.y,
            distortion: None,
            ego_from_camera: Some(rigid_to_wire(&self.ego_from_camera())),
        }
    }

    fn notes(&self) -> Vec<String> {
        let config = &self.config;
        let mut notes = vec![
            format!(
                "synthetic: a procedurally generated street, ray-traced; seed {}",
                config.seed
            ),
            match config.depth {
                DepthRecording::Lidar => format!(
                    "lidar: {} beams in the forward sector of +-{:.0} degrees, range noise {} m, every point at its own time",
                    config.lidar.beams,
                    config.lidar.half_sector_rad.to_degrees(),
                    config.lidar.range_noise_m
                ),
                DepthRecording::Maps => {
                    "depth: monocular maps with errors of scale and of pixels; no lidar".to_owned()
                }
                DepthRecording::Points => {
                    "depth: points of structure from motion, some of them wrong; no lidar"
                        .to_owned()
                }
                DepthRecording::None => "depth: none".to_owned(),
            },
        ];
        if config.mask_edge_noise > 0.0 {
            notes.push(format!(
                "instance masks have edge noise {}",
                config.mask_edge_noise
            ));
        }
        if config.pose_noise.translation_m > 0.0 || config.pose_noise.rotation_rad > 0.0 {
            notes.push(format!(
                "ego poses have noise of {} m and {} rad",
                config.pose_noise.translation_m, config.pose_noise.rotation_rad
            ));
        }
        notes
    }
}

fn record_track(actor: &Actor, last_ns: i64) -> v1::Track {
    let times = (0_i64..).map(|i| START_NS - MARGIN_NS + STATE_OFFSET_NS + i * STATE_PERIOD_NS);
    let states = times
        .take_while(|&t| t <= last_ns + MARGIN_NS)
        .map(|timestamp_ns| v1::TrackState {
            timestamp_ns,
            world_from_cuboid: Some(rigid_to_wire(
                &actor.world_from_cuboid(super::world::seconds(timestamp_ns)),
            )),
            occlusion: v1::Occlusion::Unspecified.into(),
            truncation: -1.0,
        })
        .collect();
    let van = actor.design.shape.name == "van";
    v1::Track {
        track_id: actor.track_id.clone(),
        object_class: if van {
            v1::ObjectClass::Van
        } else {
            v1::ObjectClass::Car
        }
        .into(),
        source_class: actor.design.shape.name.to_owned(),
        size_m: Some(vector_to_wire(actor.design.size_m.as_dvec3())),
        states,
    }
}

/// Instance mask in which a share of the pixels at instance edges takes the label across the edge.
fn noisy_mask(exact: &ExactFrame, share: f64, stream: u32) -> Vec<u16> {
    if share <= 0.0 {
        return exact.instance.clone();
    }
    let (width, height) = (exact.width as usize, exact.height as usize);
    (0..width * height)
        .into_par_iter()
        .map(|i| {
            let (x, y) = (i % width, i / width);
            let here = exact.instance[i];
            let neighbours = [
                (x > 0, i.wrapping_sub(1)),
                (x + 1 < width, i + 1),
                (y > 0, i.wrapping_sub(width)),
                (y + 1 < height, i + width),
            ];
            let across = neighbours
                .into_iter()
                .filter(|n| n.0)
                .map(|n| exact.instance[n.1])
                .find(|&label| label != here);
            match across {
                Some(label) if f64::from(unit(i as u32, stream, 1)) < share => label,
                _ => here,
            }
        })
        .collect()
}

fn png<P>(width: u32, height: u32, pixels: Vec<P::Subpixel>) -> Result<Vec<u8>, Error>
where
    P: Pixel + PixelWithColorType,
    [P::Subpixel]: image::EncodableLayout,
{
    let image: ImageBuffer<P, Vec<P::Subpixel>> =
        ImageBuffer::from_raw(width, height, pixels).expect("buffers have the frame's size");
    let mut bytes = Cursor::new(Vec::new());
    image.write_to(&mut bytes, ImageFormat::Png)?;
    Ok(bytes.into_inner())
}
