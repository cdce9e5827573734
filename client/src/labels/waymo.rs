//! Components in the schema of the Waymo Open Dataset, version 2.

use backlot_engine::camera::Rigid;
use backlot_proto::v1;
use glam::{DQuat, DVec3};
use parquet::errors::Result;

use super::boxes_of;
use super::parquet_file::{Values, encode};
use crate::geometry::{rigid_from_wire, vector_from_wire};

/// A sample as a segment: (component name, Parquet file) for camera images, calibrations, vehicle poses, and camera, projected, LiDAR and
/// camera-synced boxes with the association between camera and LiDAR boxes.
///
/// The vehicle frame is the ego frame and cameras look along x (y left, z up), as Waymo's do; pixels count from the first one's corner.
/// Boxes are upright: pitch and roll are lost. Images are PNG and a frame's boxes hold at the moment of its image, so that camera-synced
/// boxes are the LiDAR boxes; `num_lidar_points_in_box` is simulated. Rolling shutter, angular velocities and difficulties are null. Cameras
/// are numbered from 1 (FRONT) in the order in which they come.
///
/// # Errors
/// If a table cannot be encoded.
pub fn waymo_components(sample: &v1::Sample) -> Result<Vec<(&'static str, Vec<u8>)>> {
    let segment = Segment {
        name: waymo_segment(sample),
        cameras: cameras_of(sample),
        sample,
    };
    let components = [
        ("camera_image", segment.images()),
        ("camera_calibration", segment.calibrations()),
        ("vehicle_pose", segment.poses()),
        ("camera_box", segment.camera_boxes()),
        ("projected_lidar_box", segment.projected_boxes()),
        ("lidar_box", segment.lidar_boxes()),
        ("lidar_camera_synced_box", segment.synced_boxes()),
        ("camera_to_lidar_box_association", segment.associations()),
    ];
    components
        .into_iter()
        .map(|(name, columns)| Ok((name, encode(&columns)?)))
        .collect()
}

/// Name of a sample's segment, the stem of its files.
pub fn waymo_segment(sample: &v1::Sample) -> String {
    let provenance = sample.provenance.clone().unwrap_or_default();
    let background = provenance.background.replace('/', "_");
    format!("{background}_{}_{}", provenance.seed, sample.index)
}

type Columns = Vec<(String, Values)>;

struct Segment<'a> {
    name: String,
    /// Camera ids, the first is Waymo's camera 1.
    cameras: Vec<&'a str>,
    sample: &'a v1::Sample,
}

/// A box as one frame sees it.
struct View<'a> {
    frame: &'a v1::SampleFrame,
    box_3d: &'a v1::SampleBox,
    box_2d: &'a v1::SampleBox2D,
}

/// Maps a frame with x forward, y left, z up into a camera's with x right, y down, z forward.
const CAMERA_FROM_FORWARD: DQuat = DQuat::from_xyzw(0.5, -0.5, 0.5, 0.5);

impl<'a> Segment<'a> {
    fn views(&self) -> Vec<View<'a>> {
        let frames = self.sample.frames.iter();
        frames
            .flat_map(|frame| {
                let boxes = boxes_of(self.sample, frame);
                boxes.map(move |(box_3d, box_2d)| View {
                    frame,
                    box_3d,
                    box_2d,
                })
            })
            .collect()
    }

    fn images(&self) -> Columns {
        let frames = &self.sample.frames;
        let name = |column: &str| format!("[CameraImageComponent].{column}");
        let mut columns = self.frame_keys(frames.iter());
        columns.push(self.camera_key(frames.iter()));
        let images = frames.iter().map(|f| f.image_png.clone());
        columns.push((name("image"), Values::Bytes(images.collect())));
        let poses = frames.iter().map(|f| matrix(&world_from_ego(f)));
        columns.push((name("pose.transform"), Values::Matrix(poses.collect())));
        for (axis, letter) in ["x", "y", "z"].into_iter().enumerate() {
            let values = (0..frames.len()).map(|k| ego_velocity(frames, k).map(|v| v[axis] as f32));
            let column = name(&format!("velocity.linear_velocity.{letter}"));
            columns.push((column, Values::Float(values.collect())));
        }
        let unknown = vec![None; frames.len()];
        push_vector(&mut columns, &name("velocity.angular_velocity"), &unknown);
        let times = frames.iter().map(|f| Some(f.timestamp_ns as f64 * 1e-9));
        columns.push((name("pose_timestamp"), Values::Double(times.collect())));
        for field in ["shutter", "camera_trigger_time", "camera_readout_done_time"] {
            let unknown = Values::Double(vec![None; frames.len()]);
            columns.push((name(&format!("rolling_shutter_params.{field}")), unknown));
        }
        columns
    }

    fn calibrations(&self) -> Columns {
        let of_camera = |id: &&str| self.sample.frames.iter().find(|f| f.camera_id == **id);
        let frames: Vec<&v1::SampleFrame> = self.cameras.iter().filter_map(of_camera).collect();
        let views: Vec<v1::CameraView> =
            frames.iter().map(|f| f.view.unwrap_or_default()).collect();
        let name = |column: &str| format!("[CameraCalibrationComponent].{column}");
        let segment = vec![self.name.clone(); frames.len()];
        let mut columns = vec![
            ("key.segment_context_name".to_owned(), Values::Text(segment)),
            self.camera_key(frames.iter().copied()),
        ];
        let mut number = |column: &str, of: fn(&v1::CameraView) -> f64| {
            let values = views.iter().map(|v| Some(of(v))).collect();
            columns.push((name(&format!("intrinsic.{column}")), Values::Double(values)));
        };
        number("f_u", |v| v.focal_x_px);
        number("f_v", |v| v.focal_y_px);
        number("c_u", |v| v.principal_x_px);
        number("c_v", |v| v.principal_y_px);
        for distortion in ["k1", "k2", "p1", "p2", "k3"] {
            number(distortion, |_| 0.0);
        }
        let extrinsics = frames.iter().zip(&views).map(|(frame, view)| {
            let world_from_camera = rigid_from_wire(view.world_from_camera.as_ref());
            let forward = Rigid::new(CAMERA_FROM_FORWARD, DVec3::ZERO);
            matrix(&(world_from_ego(frame).inverse() * world_from_camera * forward))
        });
        let extrinsics = Values::Matrix(extrinsics.collect());
        columns.push((name("extrinsic.transform"), extrinsics));
        let side = |of: fn(&v1::CameraView) -> u32| {
            Values::Int32(views.iter().map(|v| of(v) as i32).collect())
        };
        columns.push((name("width"), side(|v| v.width)));
        columns.push((name("height"), side(|v| v.height)));
        // GLOBAL_SHUTTER: every pixel is rendered at one pose.
        let direction = Values::Int8(vec![5; frames.len()]);
        columns.push((name("rolling_shutter_direction"), direction));
        columns
    }

    fn poses(&self) -> Columns {
        let frames = &self.sample.frames;
        let mut columns = self.frame_keys(frames.iter());
        let poses = frames.iter().map(|f| matrix(&world_from_ego(f))).collect();
        columns.push((
            "[VehiclePoseComponent].world_from_vehicle.transform".to_owned(),
            Values::Matrix(poses),
        ));
        columns
    }

    fn camera_boxes(&self) -> Columns {
        let mut views = self.views();
        views.retain(|v| v.box_2d.visible.is_some());
        let mut columns = self.camera_label_keys(&views);
        let boxes = views.iter().filter_map(|v| v.box_2d.visible.as_ref());
        push_rectangles(&mut columns, "[CameraBoxComponent].box", boxes);
        columns.push(types("[CameraBoxComponent].type", &views));
        push_no_difficulty(&mut columns, "[CameraBoxComponent]", views.len());
        columns
    }

    fn projected_boxes(&self) -> Columns {
        let mut views = self.views();
        views.retain(|v| v.box_2d.amodal.is_some());
        let frames = views.iter().map(|v| v.frame);
        let mut columns = self.frame_keys(frames.clone());
        columns.push(laser_ids(&views));
        columns.push(self.camera_key(frames));
        let boxes = views.iter().filter_map(|v| v.box_2d.amodal.as_ref());
        push_rectangles(&mut columns, "[ProjectedLiDARBoxComponent].box", boxes);
        columns.push(types("[ProjectedLiDARBoxComponent].type", &views));
        columns
    }

    fn lidar_boxes(&self) -> Columns {
        let views = self.views();
        let mut columns = self.frame_keys(views.iter().map(|v| v.frame));
        columns.push(laser_ids(&views));
        push_cuboids(&mut columns, "[LiDARBoxComponent].box", &views);
        columns.push(types("[LiDARBoxComponent].type", &views));
        let points = views.iter().map(|v| i64::from(v.box_2d.lidar_points));
        let points: Vec<i64> = points.collect();
        for column in ["num_lidar_points_in_box", "num_top_lidar_points_in_box"] {
            let name = format!("[LiDARBoxComponent].{column}");
            columns.push((name, Values::Int64(points.clone())));
        }
        // Waymo's speeds are the world's, in the axes of the vehicle.
        let speeds = views.iter().map(|v| {
            let velocity = v.box_2d.velocity_mps.as_ref()?;
            let ego_from_world = world_from_ego(v.frame).inverse();
            Some(ego_from_world.direction(vector_from_wire(Some(velocity))))
        });
        let speeds: Vec<_> = speeds.collect();
        push_vector(&mut columns, "[LiDARBoxComponent].speed", &speeds);
        let unknown = vec![None; views.len()];
        push_vector(&mut columns, "[LiDARBoxComponent].acceleration", &unknown);
        push_no_difficulty(&mut columns, "[LiDARBoxComponent]", views.len());
        columns
    }

    fn synced_boxes(&self) -> Columns {
        let views = self.views();
        let frames = views.iter().map(|v| v.frame);
        let mut columns = self.frame_keys(frames.clone());
        columns.push(laser_ids(&views));
        let name = "[LiDARCameraSyncedBoxComponent].most_visible_camera_name";
        let (_, cameras) = self.camera_key(frames);
        columns.push((name.to_owned(), cameras));
        let name = "[LiDARCameraSyncedBoxComponent].camera_synced_box";
        push_cuboids(&mut columns, name, &views);
        columns
    }

    fn associations(&self) -> Columns {
        let mut views = self.views();
        views.retain(|v| v.box_2d.visible.is_some());
        let mut columns = self.camera_label_keys(&views);
        columns.push(laser_ids(&views));
        columns
    }

    fn frame_keys<'f>(&self, frames: impl Iterator<Item = &'f v1::SampleFrame>) -> Columns {
        let times: Vec<i64> = frames.map(|f| f.timestamp_ns.div_euclid(1000)).collect();
        let segment = vec![self.name.clone(); times.len()];
        vec![
            ("key.segment_context_name".to_owned(), Values::Text(segment)),
            (
                "key.frame_timestamp_micros".to_owned(),
                Values::Int64(times),
            ),
        ]
    }

    fn camera_key<'f>(
        &self,
        frames: impl Iterator<Item = &'f v1::SampleFrame>,
    ) -> (String, Values) {
        let number = |frame: &v1::SampleFrame| {
            let at = self.cameras.iter().position(|id| *id == frame.camera_id);
            at.map_or(0, |i| i as i32 + 1)
        };
        let names = frames.map(number).collect();
        ("key.camera_name".to_owned(), Values::Int8(names))
    }

    fn camera_label_keys(&self, views: &[View<'_>]) -> Columns {
        let frames = views.iter().map(|v| v.frame);
        let mut columns = self.frame_keys(frames.clone());
        columns.push(self.camera_key(frames));
        let ids = views.iter().map(object_id).collect();
        columns.push(("key.camera_object_id".to_owned(), Values::Text(ids)));
        columns
    }
}

fn cameras_of(sample: &v1::Sample) -> Vec<&str> {
    let mut cameras: Vec<&str> = Vec::new();
    for frame in &sample.frames {
        if !cameras.contains(&frame.camera_id.as_str()) {
            cameras.push(&frame.camera_id);
        }
    }
    cameras
}

fn object_id(view: &View<'_>) -> String {
    view.box_3d.instance_id.to_string()
}

fn laser_ids(views: &[View<'_>]) -> (String, Values) {
    let ids = views.iter().map(object_id).collect();
    ("key.laser_object_id".to_owned(), Values::Text(ids))
}

/// TYPE_UNKNOWN is 0, TYPE_VEHICLE 1, TYPE_PEDESTRIAN 2, TYPE_CYCLIST 4.
fn types(name: &str, views: &[View<'_>]) -> (String, Values) {
    let types = views.iter().map(|v| match v.box_3d.object_class() {
        v1::ObjectClass::Pedestrian => 2,
        v1::ObjectClass::Cyclist => 4,
        v1::ObjectClass::Other | v1::ObjectClass::Unspecified => 0,
        _ => 1,
    });
    (name.to_owned(), Values::Int8(types.collect()))
}

fn push_no_difficulty(columns: &mut Columns, component: &str, rows: usize) {
    for task in ["detection", "tracking"] {
        let name = format!("{component}.difficulty_level.{task}");
        columns.push((name, Values::NoInt8(rows)));
    }
}

fn push_vector(columns: &mut Columns, name: &str, values: &[Option<DVec3>]) {
    for (axis, letter) in ["x", "y", "z"].into_iter().enumerate() {
        let values = values.iter().map(|v| v.map(|v| v[axis])).collect();
        columns.push((format!("{name}.{letter}"), Values::Double(values)));
    }
}

fn push_rectangles<'b>(
    columns: &mut Columns,
    name: &str,
    boxes: impl Iterator<Item = &'b v1::Box2D>,
) {
    let boxes: Vec<&v1::Box2D> = boxes.collect();
    let mut push = |column: &str, of: fn(&v1::Box2D) -> f64| {
        let values = boxes.iter().map(|b| Some(of(b))).collect();
        columns.push((format!("{name}.{column}"), Values::Double(values)));
    };
    push("center.x", |b| 0.5 * (b.x_min + b.x_max));
    push("center.y", |b| 0.5 * (b.y_min + b.y_max));
    push("size.x", |b| b.x_max - b.x_min);
    push("size.y", |b| b.y_max - b.y_min);
}

fn push_cuboids(columns: &mut Columns, name: &str, views: &[View<'_>]) {
    let poses = views
        .iter()
        .map(|v| rigid_from_wire(v.box_2d.ego_from_cuboid.as_ref()));
    let poses: Vec<Rigid> = poses.collect();
    let centres: Vec<_> = poses.iter().map(|p| Some(p.translation_m)).collect();
    push_vector(columns, &format!("{name}.center"), &centres);
    let sizes = views.iter().map(|v| {
        let cuboid = v.box_3d.cuboid.as_ref();
        Some(vector_from_wire(cuboid.and_then(|c| c.size_m.as_ref())))
    });
    push_vector(columns, &format!("{name}.size"), &sizes.collect::<Vec<_>>());
    let headings = poses.iter().map(|p| Some(p.heading_rad())).collect();
    columns.push((format!("{name}.heading"), Values::Double(headings)));
}

/// From the frames before and after in the world frame; `None` for a single one.
fn ego_velocity(frames: &[v1::SampleFrame], k: usize) -> Option<DVec3> {
    let (from, to) = (
        &frames[k.saturating_sub(1)],
        &frames[(k + 1).min(frames.len() - 1)],
    );
    let span_s = (to.timestamp_ns - from.timestamp_ns) as f64 * 1e-9;
    let way = world_from_ego(to).translation_m - world_from_ego(from).translation_m;
    (span_s > 0.0).then(|| way / span_s)
}

fn world_from_ego(frame: &v1::SampleFrame) -> Rigid {
    rigid_from_wire(frame.world_from_ego.as_ref())
}

/// Row-major.
fn matrix(rigid: &Rigid) -> [f64; 16] {
    let r = rigid.rotation_matrix();
    let t = rigid.translation_m;
    let row = |i: usize| [r.col(0)[i], r.col(1)[i], r.col(2)[i], t[i]];
    let [a, b, c] = [row(0), row(1), row(2)];
    std::array::from_fn(|i| [a, b, c, [0.0, 0.0, 0.0, 1.0]][i / 4][i % 4])
}
