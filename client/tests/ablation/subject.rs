//! A drive past parked cars, and one of them with its training set.

use std::io;

use backlot_client::generator::{ActorPose, RenderOptions, StreetConfig, StreetWorld, View};
use backlot_client::read_log::ReadLog;
use backlot_engine::camera::Rigid;
use backlot_engine::train::ObjectInput;
use backlot_engine::view::{PixelLabel, Split, TrainView};
use backlot_proto::v1;
use backlot_server::api::convert_drive_log::drive_log_from_wire;
use backlot_server::domain::drive_log::DriveLog;
use backlot_server::ingest::{LogLabels, object_set, plan_objects, validate};
use glam::{DMat3, DQuat, DVec3};
use image::{DynamicImage, ImageBuffer, ImageFormat, Luma};

/// One frame in so many has a bad mask.
const BAD_EVERY: usize = 5;
/// A bad mask is wrong this far from the car's outline, in pixels.
const FLIPPED_PX: i64 = 4;

/// A drive past parked cars, which are seen from behind and from the road only.
pub(crate) fn street() -> StreetWorld {
    let config = StreetConfig {
        seed: 3,
        frames: 30,
        width: 320,
        height: 192,
        travel_m: 24.0,
        horizontal_fov_rad: 1.4,
        moving_cars: 0,
        ..StreetConfig::default()
    };
    StreetWorld::new(&config).expect("the configuration is valid")
}

pub(crate) fn decoded(log: &ReadLog) -> DriveLog {
    let wire = v1::DriveLog {
        name: "driveLogs/street".to_owned(),
        ..log.drive_log.clone()
    };
    let drive_log = drive_log_from_wire(wire).expect("the log converts");
    let accepted = validate(&drive_log, log).expect("blobs are in memory");
    accepted.expect("the log is valid");
    drive_log
}

/// A parked car of the street with its training set.
pub(crate) struct Subject {
    world: StreetWorld,
    track_id: String,
    pub(crate) input: ObjectInput,
    /// Frames that show it.
    frames: Vec<usize>,
}

/// The car with the most pixels; in a fifth of the frames the pixels around its outline are on the wrong side of it.
pub(crate) fn subject() -> Subject {
    let world = street();
    let mut log = world.read_log().expect("the street can be recorded");
    let plan = plan_objects(&decoded(&log)).swap_remove(0);
    for frame in plan.frames.iter().skip(2).step_by(BAD_EVERY) {
        flip_edges(&mut log, *frame, plan.track as u16 + 1);
    }
    let drive_log = decoded(&log);
    let set = object_set(&drive_log, &log, &LogLabels::default(), &plan, 0, |_, _| {
        true
    });
    let set = set.expect("frames load").expect("nothing stops it");
    let (views, rejected) = (set.input.views.len(), &set.rejected);
    assert!(
        views >= 12,
        "{views} views, {:?}, {rejected:?}",
        plan.rejected
    );
    Subject {
        track_id: drive_log.tracks[plan.track].track_id.clone(),
        frames: plan.frames,
        input: set.input,
        world,
    }
}

/// Inverts one instance's mask near its outline, as a segmenter that misses it does.
fn flip_edges(log: &mut ReadLog, frame: usize, instance: u16) {
    let stored = log.drive_log.frames[frame].instance_mask.as_ref();
    let content = log.read_blob(stored.expect("every frame has a mask"));
    let mask = image::load_from_memory(&content.expect("the blob is in memory"))
        .expect("the mask decodes")
        .into_luma16();
    let (width, height) = (i64::from(mask.width()), i64::from(mask.height()));
    let is_car = |x: i64, y: i64| mask.get_pixel(x as u32, y as u32).0[0] == instance;
    let flipped: ImageBuffer<Luma<u16>, Vec<u16>> =
        ImageBuffer::from_fn(mask.width(), mask.height(), |u, v| {
            let (x, y) = (i64::from(u), i64::from(v));
            let rows = (y - FLIPPED_PX).max(0)..=(y + FLIPPED_PX).min(height - 1);
            let mut near = rows.flat_map(|row| {
                let columns = (x - FLIPPED_PX).max(0)..=(x + FLIPPED_PX).min(width - 1);
                columns.map(move |column| (column, row))
            });
            let car = is_car(x, y);
            match (near.any(|(column, row)| is_car(column, row) != car), car) {
                (false, _) => *mask.get_pixel(u, v),
                (true, true) => Luma([0]),
                (true, false) => Luma([instance]),
            }
        });
    let mut bytes = io::Cursor::new(Vec::new());
    DynamicImage::from(flipped)
        .write_to(&mut bytes, ImageFormat::Png)
        .expect("a PNG is written to memory");
    log.drive_log.frames[frame].instance_mask = Some(log.add_bytes(bytes.into_inner()));
}

impl Subject {
    fn pose(&self) -> ActorPose {
        let actors = self.world.actors_at(self.world.frame_timestamps_ns()[0]);
        let mut actors = actors.into_iter();
        let own = actors.find(|actor| actor.track_id == self.track_id);
        own.expect("the car is in the street")
    }

    /// An exact view of the car by itself in the street, with true labels.
    fn view(&self, number: u32, view: &View) -> TrainView {
        let pose = self.pose();
        let options = RenderOptions::default();
        let actors = std::slice::from_ref(&pose);
        let exact = self
            .world
            .render(view, actors, &options)
            .expect("it renders");
        let label = |instance: &u16| match instance {
            1 => PixelLabel::Foreground,
            _ => PixelLabel::Background,
        };
        TrainView {
            frame_index: number,
            camera: view.camera,
            local_from_camera: pose.world_from_cuboid.inverse() * view.world_from_camera,
            labels: exact.instance.iter().map(label).collect(),
            rgb: exact.rgb8,
            depth: Vec::new(),
            split: Split::HeldOut,
        }
    }

    /// Views of the drive between the recorded ones.
    pub(crate) fn seen_side(&self) -> Vec<TrainView> {
        let views = self.between().into_iter();
        views.map(|view| self.view(900, &view)).collect()
    }

    /// The same from the other side of the car, which the drive never saw.
    pub(crate) fn unseen_side(&self) -> Vec<TrainView> {
        let world_from_cuboid = self.pose().world_from_cuboid;
        let views = self.between().into_iter().map(|view| {
            let cuboid_from_camera = world_from_cuboid.inverse() * view.world_from_camera;
            let reflected = |p: DVec3| DVec3::new(p.x, -p.y, p.z);
            let eye = reflected(cuboid_from_camera.translation_m);
            let forward = reflected(cuboid_from_camera.direction(DVec3::Z));
            let world_from_camera = world_from_cuboid * look_at(eye, eye + forward);
            self.view(
                950,
                &View {
                    world_from_camera,
                    ..view
                },
            )
        });
        views.collect()
    }

    fn between(&self) -> Vec<View> {
        let times = self.world.frame_timestamps_ns();
        let pairs = self.frames.windows(2).step_by(3);
        let middle = pairs.map(|pair| times[pair[0]].midpoint(times[pair[1]]));
        middle.map(|time_ns| self.world.view_at(time_ns)).collect()
    }
}

/// Camera axes (x right, y down, z forward) looking from `eye` at `target`.
fn look_at(eye: DVec3, target: DVec3) -> Rigid {
    let forward = (target - eye).normalize();
    let right = forward.cross(DVec3::Z).normalize();
    let rotation = DMat3::from_cols(right, forward.cross(right), forward);
    Rigid::new(DQuat::from_mat3(&rotation).normalize(), eye)
}
