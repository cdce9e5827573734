//! How far two logs are apart, in the units of what is promised.

use backlot_client::geometry::{box_corners, camera_from_wire, rigid_from_wire, vector_from_wire};
use backlot_client::motion::track_pose_at;
use backlot_client::read_log::ReadLog;
use backlot_engine::camera::{NEAR_M, Rigid};
use backlot_proto::v1;
use glam::DVec3;

use crate::street::{ego_at, returns, world_m};

/// What a conversion may lose.
pub(crate) const LIMITS: Deviation = Deviation {
    position_m: 1e-3,
    angle_rad: 0.01 * std::f64::consts::PI / 180.0,
    time_ns: 1000,
    corner_px: 0.1,
    point_m: 1e-3,
    intensity: 0.5 / 255.0,
};

/// The largest differences.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Deviation {
    /// Of ego poses and cuboid centres.
    pub(crate) position_m: f64,
    pub(crate) angle_rad: f64,
    pub(crate) time_ns: i64,
    /// Of projected cuboid corners.
    pub(crate) corner_px: f64,
    /// Of LiDAR returns in the world.
    pub(crate) point_m: f64,
    pub(crate) intensity: f64,
}

impl Deviation {
    pub(crate) fn is_within(&self, limits: &Self) -> bool {
        self.position_m <= limits.position_m
            && self.angle_rad <= limits.angle_rad
            && self.time_ns <= limits.time_ns
            && self.corner_px <= limits.corner_px
            && self.point_m <= limits.point_m
            && self.intensity <= limits.intensity
    }

    fn pose(&mut self, a: &Rigid, b: &Rigid) {
        let moved = a.translation_m.distance(b.translation_m);
        self.position_m = self.position_m.max(moved);
        assert!(moved.is_finite(), "a pose is not finite");
        let half_sine = (a.rotation.conjugate() * b.rotation).xyz().length();
        let turned = 2.0 * half_sine.min(1.0).asin();
        self.angle_rad = self.angle_rad.max(turned);
    }
}

/// What differs in kind between a log and the same log read from a data set.
pub(crate) struct Comparison<'a> {
    /// Times at which the data set labels boxes.
    pub(crate) box_times_ns: &'a [i64],
    /// Names in the data set of cameras and tracks.
    pub(crate) camera_id: &'a dyn Fn(&str) -> String,
    pub(crate) track_id: &'a dyn Fn(&str) -> String,
}

/// Compares everything that the data set carries; panics where a camera, frame, sweep or track is missing or in excess.
pub(crate) fn deviation(expected: &ReadLog, got: &ReadLog, how: &Comparison<'_>) -> Deviation {
    let mut deviation = Deviation::default();
    compare_frames(expected, got, how, &mut deviation);
    compare_sweeps(expected, got, &mut deviation);
    compare_tracks(&expected.drive_log, &got.drive_log, how, &mut deviation);
    deviation
}

fn compare_frames(expected: &ReadLog, got: &ReadLog, how: &Comparison<'_>, d: &mut Deviation) {
    let (expected, got) = (&expected.drive_log, &got.drive_log);
    assert_eq!(expected.cameras.len(), got.cameras.len(), "cameras");
    assert_eq!(expected.frames.len(), got.frames.len(), "frames");
    for frame in &expected.frames {
        let camera_id = (how.camera_id)(&frame.camera_id);
        let same =
            |f: &&v1::CameraFrame| f.camera_id == camera_id && f.frame_index == frame.frame_index;
        let read = got.frames.iter().find(same).expect("the frame is there");
        assert_eq!(read.image, frame.image, "image of {camera_id}");
        let apart = (read.timestamp_ns - frame.timestamp_ns).abs();
        d.time_ns = d.time_ns.max(apart);
        d.pose(
            &ego_at(expected, frame.timestamp_ns),
            &ego_at(got, read.timestamp_ns),
        );
    }
}

fn compare_sweeps(expected: &ReadLog, got: &ReadLog, d: &mut Deviation) {
    let (a, b) = (&expected.drive_log, &got.drive_log);
    assert_eq!(a.sweeps.len(), b.sweeps.len(), "sweeps");
    for (sweep, read) in a.sweeps.iter().zip(&b.sweeps) {
        d.time_ns = d
            .time_ns
            .max((sweep.timestamp_ns - read.timestamp_ns).abs());
        let place = |log: &ReadLog, sweep: &v1::LidarSweep| -> Vec<(DVec3, f32)> {
            returns(log, sweep)
                .iter()
                .map(|point| (world_m(&log.drive_log, sweep, point), point.intensity))
                .collect()
        };
        let (expected, got) = (place(expected, sweep), place(got, read));
        assert_eq!(expected.len(), got.len(), "points of a sweep");
        for (position, intensity) in expected {
            let nearest = got
                .iter()
                .min_by(|a, b| {
                    let distance = |p: &(DVec3, f32)| p.0.distance_squared(position);
                    distance(a).total_cmp(&distance(b))
                })
                .expect("a sweep has points");
            d.point_m = d.point_m.max(nearest.0.distance(position));
            d.intensity = d.intensity.max(f64::from((nearest.1 - intensity).abs()));
        }
    }
}

fn compare_tracks(a: &v1::DriveLog, b: &v1::DriveLog, how: &Comparison<'_>, d: &mut Deviation) {
    assert_eq!(a.tracks.len(), b.tracks.len(), "tracks");
    for track in &a.tracks {
        let id = (how.track_id)(&track.track_id);
        let read = b.tracks.iter().find(|t| t.track_id == id);
        let read = read.expect("the track is there");
        assert_eq!(read.states.len(), how.box_times_ns.len(), "states of {id}");
        for &at in how.box_times_ns {
            let pose = |track, at| track_pose_at(track, at).expect("the track has a box");
            let state = read
                .states
                .iter()
                .min_by_key(|s| (s.timestamp_ns - at).abs());
            let read_at = state.expect("a track has states").timestamp_ns;
            d.time_ns = d.time_ns.max((read_at - at).abs());
            let (expected, got) = (pose(track, at), pose(read, read_at));
            d.pose(&expected, &got);
            for camera in &a.cameras {
                let camera_id = (how.camera_id)(&camera.camera_id);
                let read_camera = b.cameras.iter().find(|c| c.camera_id == camera_id);
                let corners = corners_px(a, camera, track, &expected, at);
                let read_camera = read_camera.expect("the camera is there");
                for pair in corners
                    .into_iter()
                    .zip(corners_px(b, read_camera, read, &got, read_at))
                {
                    d.corner_px = match pair {
                        (Some(p), Some(q)) => d.corner_px.max(p.distance(q)),
                        (None, None) => d.corner_px,
                        _ => f64::INFINITY,
                    };
                }
            }
        }
    }
}

/// The projected corners of a track's box at a time, in the order of `box_corners`; none for those behind the camera.
pub(crate) fn corners_px(
    log: &v1::DriveLog,
    camera: &v1::Camera,
    track: &v1::Track,
    world_from_cuboid: &Rigid,
    image_time_ns: i64,
) -> Vec<Option<glam::DVec2>> {
    let ego_from_camera = rigid_from_wire(camera.ego_from_camera.as_ref());
    let camera_from_world = (ego_at(log, image_time_ns) * ego_from_camera).inverse();
    let model = camera_from_wire(camera).expect("the camera is complete");
    box_corners(vector_from_wire(track.size_m.as_ref()))
        .into_iter()
        .map(|corner| (camera_from_world * *world_from_cuboid).point(corner))
        .map(|p| if p.z > NEAR_M { model.project(p) } else { None })
        .collect()
}

/// Makes a log a little wrong.
type Flaw = fn(&mut v1::DriveLog);

/// Logs that differ from the right one by little more than what is allowed: each must be told apart.
pub(crate) const FLAWS: [(&str, Flaw); 8] = [
    ("ego 2 mm off", |log| {
        for pose in &mut log.world_from_ego {
            shift(&mut pose.pose, DVec3::new(0.0, 2e-3, 0.0));
        }
    }),
    ("boxes 2 mm off", |log| {
        for state in log.tracks.iter_mut().flat_map(|t| &mut t.states) {
            shift(&mut state.world_from_cuboid, DVec3::new(0.0, 0.0, 2e-3));
        }
    }),
    ("boxes turned by 0.02 degrees", |log| {
        for state in log.tracks.iter_mut().flat_map(|t| &mut t.states) {
            let pose = rigid_from_wire(state.world_from_cuboid.as_ref());
            let turn = Rigid::from_heading(0.02_f64.to_radians(), DVec3::ZERO);
            state.world_from_cuboid = Some(backlot_client::geometry::rigid_to_wire(&(pose * turn)));
        }
    }),
    ("images 2 us late", |log| {
        for frame in &mut log.frames {
            frame.timestamp_ns += 2000;
        }
    }),
    ("principal point half a pixel off", |log| {
        for camera in &mut log.cameras {
            camera.principal_x_px += 0.5;
        }
    }),
    ("cameras that look back", |log| {
        for camera in &mut log.cameras {
            let pose = rigid_from_wire(camera.ego_from_camera.as_ref());
            let back = Rigid::from_heading(std::f64::consts::PI, DVec3::ZERO);
            camera.ego_from_camera = Some(backlot_client::geometry::rigid_to_wire(&(back * pose)));
        }
    }),
    ("length and width exchanged", |log| {
        for size in log.tracks.iter_mut().filter_map(|t| t.size_m.as_mut()) {
            std::mem::swap(&mut size.x, &mut size.y);
        }
    }),
    ("scanner 3 mm higher", |log| {
        for sweep in &mut log.sweeps {
            shift(&mut sweep.ego_from_lidar, DVec3::new(0.0, 0.0, 3e-3));
        }
    }),
];

fn shift(pose: &mut Option<v1::RigidTransform>, by_m: DVec3) {
    let mut rigid = rigid_from_wire(pose.as_ref());
    rigid.translation_m += by_m;
    *pose = Some(backlot_client::geometry::rigid_to_wire(&rigid));
}
