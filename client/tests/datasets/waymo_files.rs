//! Writes a log as Waymo Open v2 does: a Parquet file for each component, range images for sweeps.

use std::collections::BTreeMap;
use std::f64::consts::PI;
use std::path::Path;
use std::sync::Arc;

use backlot_client::geometry::{rigid_from_wire, vector_from_wire};
use backlot_client::motion::track_pose_at;
use backlot_client::read_log::ReadLog;
use backlot_engine::camera::Rigid;
use backlot_proto::v1;
use glam::{DMat3, DQuat, DVec3, EulerRot};
use parquet::basic::{Compression, ConvertedType, Repetition, Type as PhysicalType};
use parquet::data_type::{
    ByteArray, ByteArrayType, DataType, DoubleType, FloatType, Int32Type, Int64Type,
};
use parquet::file::properties::WriterProperties;
use parquet::file::writer::{SerializedFileWriter, SerializedRowGroupWriter};
use parquet::schema::types::{Type, TypePtr};

use crate::nuscenes_files::put;
use crate::street::{BEAMS, TURN_COLUMNS, ego_at, elevations_rad, returns};

pub(crate) const SEGMENT: &str = "street_segment";
/// The top scanner.
const TOP: i32 = 1;
/// Readout and shutter of the cameras, in seconds.
const READOUT_S: f64 = 0.044;
const SHUTTER_S: f64 = 0.006;
const SIDE_DELAY_NS: i64 = 40_000_000;

/// Numbers of the street's cameras.
fn camera_number(camera_id: &str) -> i32 {
    if camera_id == "front" { 1 } else { 2 }
}

pub(crate) fn camera_name(camera_id: &str) -> String {
    ["FRONT", "FRONT_LEFT"][camera_number(camera_id) as usize - 1].to_owned()
}

/// Times of the frames: those of the sweeps.
pub(crate) fn frame_times_ns(log: &v1::DriveLog) -> Vec<i64> {
    log.sweeps.iter().map(|sweep| sweep.timestamp_ns).collect()
}

/// Writes the segment below `root`. `uniform` leaves the list of beams out: they are evenly spaced then.
pub(crate) fn write(log: &ReadLog, root: &Path, uniform: bool) {
    let manifest = &log.drive_log;
    let put_table = |component: &str, columns: Vec<Column>| {
        let name = format!("{component}/{SEGMENT}.parquet");
        put(root, &name, &parquet(columns, Compression::SNAPPY));
    };
    put_table("camera_calibration", camera_calibration(manifest));
    put_table("camera_image", camera_images(log));
    put_table("vehicle_pose", vehicle_poses(manifest));
    put_table("lidar_calibration", lidar_calibration(manifest, uniform));
    let (lidar, poses) = range_images(log);
    put_table("lidar", lidar);
    put_table("lidar_pose", poses);
    put_table("lidar_box", boxes(manifest));
}

/// Labels of the first image: the upper half is sky, the rest road with an instance on it.
pub(crate) fn write_segmentation(log: &ReadLog, root: &Path) {
    const DIVISOR: u16 = 1000;
    let manifest = &log.drive_log;
    let camera = &manifest.cameras[0];
    let label = image::ImageBuffer::from_fn(camera.width, camera.height, |_, y| {
        let (sky, road, instance) = (25, 20, 7);
        image::Luma([if y < camera.height / 2 {
            sky * DIVISOR
        } else {
            road * DIVISOR + instance
        }])
    });
    let mut png = std::io::Cursor::new(Vec::new());
    label
        .write_to(&mut png, image::ImageFormat::Png)
        .expect("the label encodes");
    let of = |name: &str| format!("[CameraSegmentationLabelComponent].{name}");
    let columns = vec![
        context(1),
        column(
            "key.frame_timestamp_micros",
            Cells::Integers(vec![micros(manifest.frames[0].timestamp_ns)]),
        ),
        column("key.camera_name", Cells::Bytes(vec![1])),
        (
            of("panoptic_label_divisor"),
            Cells::Bytes(vec![DIVISOR.into()]),
        ),
        (of("panoptic_label"), Cells::Blobs(vec![png.into_inner()])),
    ];
    let name = format!("camera_segmentation/{SEGMENT}.parquet");
    put(root, &name, &parquet(columns, Compression::SNAPPY));
}

/// A column's name and its rows.
pub(crate) type Column = (String, Cells);

pub(crate) enum Cells {
    Integers(Vec<i64>),
    Bytes(Vec<i32>),
    Doubles(Vec<f64>),
    Texts(Vec<String>),
    Blobs(Vec<Vec<u8>>),
    DoubleLists(Vec<Vec<f64>>),
    FloatLists(Vec<Vec<f32>>),
    IntegerLists(Vec<Vec<i32>>),
}

fn column(name: &str, cells: Cells) -> Column {
    (name.to_owned(), cells)
}

fn context(rows: usize) -> Column {
    column(
        "key.segment_context_name",
        Cells::Texts(vec![SEGMENT.to_owned(); rows]),
    )
}

fn micros(ns: i64) -> i64 {
    assert_eq!(ns % 1000, 0, "frames are at whole microseconds");
    ns / 1000
}

/// Row by row.
fn matrix(pose: &Rigid) -> Vec<f64> {
    let (r, t) = (DMat3::from_quat(pose.rotation), pose.translation_m);
    let mut rows = Vec::with_capacity(16);
    for i in 0..3 {
        rows.extend([r.row(i).x, r.row(i).y, r.row(i).z, t[i]]);
    }
    rows.extend([0.0, 0.0, 0.0, 1.0]);
    rows
}

fn camera_calibration(log: &v1::DriveLog) -> Vec<Column> {
    // The data set's cameras look along x, with y left and z up.
    let opencv_from_forward = Rigid::new(
        DQuat::from_mat3(&DMat3::from_cols(DVec3::Z, DVec3::NEG_X, DVec3::NEG_Y)),
        DVec3::ZERO,
    );
    let cameras = &log.cameras;
    let numbers =
        |of: &dyn Fn(&v1::Camera) -> f64| Cells::Doubles(cameras.iter().map(of).collect());
    let k = |c: &v1::Camera, i: usize| c.distortion.as_ref().map_or(0.0, |d| d.coefficients[i]);
    let poses = cameras
        .iter()
        .map(|c| rigid_from_wire(c.ego_from_camera.as_ref()) * opencv_from_forward);
    let of = |name: &str| format!("[CameraCalibrationComponent].{name}");
    vec![
        context(cameras.len()),
        column(
            "key.camera_name",
            Cells::Bytes(
                cameras
                    .iter()
                    .map(|c| camera_number(&c.camera_id))
                    .collect(),
            ),
        ),
        (of("intrinsic.f_u"), numbers(&|c| c.focal_x_px)),
        (of("intrinsic.f_v"), numbers(&|c| c.focal_y_px)),
        (of("intrinsic.c_u"), numbers(&|c| c.principal_x_px)),
        (of("intrinsic.c_v"), numbers(&|c| c.principal_y_px)),
        (of("intrinsic.k1"), numbers(&|c| k(c, 0))),
        (of("intrinsic.k2"), numbers(&|c| k(c, 1))),
        (of("intrinsic.p1"), numbers(&|c| k(c, 2))),
        (of("intrinsic.p2"), numbers(&|c| k(c, 3))),
        (of("intrinsic.k3"), numbers(&|c| k(c, 4))),
        (
            of("extrinsic.transform"),
            Cells::DoubleLists(poses.map(|p| matrix(&p)).collect()),
        ),
        (
            of("width"),
            Cells::Bytes(cameras.iter().map(|c| c.width as i32).collect()),
        ),
        (
            of("height"),
            Cells::Bytes(cameras.iter().map(|c| c.height as i32).collect()),
        ),
        (
            of("rolling_shutter_direction"),
            Cells::Bytes(vec![2; cameras.len()]),
        ),
    ]
}

fn camera_images(log: &ReadLog) -> Vec<Column> {
    let manifest = &log.drive_log;
    let mut frames: Vec<&v1::CameraFrame> = manifest.frames.iter().collect();
    frames.sort_by_key(|f| (f.frame_index, camera_number(&f.camera_id)));
    let seconds = |ns: i64| ns as f64 * 1e-9;
    // Images of one frame of the segment share its time, whenever they were taken.
    let frame_time = |f: &v1::CameraFrame| {
        micros(
            (f.timestamp_ns
                - if f.camera_id == "side" {
                    SIDE_DELAY_NS
                } else {
                    0
                })
                / 1_000_000
                * 1_000_000,
        )
    };
    let image = |f: &&v1::CameraFrame| {
        let blob = f.image.as_ref().expect("a frame has an image");
        log.read_blob(blob).expect("the image is readable").to_vec()
    };
    let half_s = (READOUT_S + SHUTTER_S) / 2.0;
    let of = |name: &str| format!("[CameraImageComponent].{name}");
    let times = |shift: f64| {
        Cells::Doubles(
            frames
                .iter()
                .map(|f| seconds(f.timestamp_ns) + shift)
                .collect(),
        )
    };
    vec![
        context(frames.len()),
        column(
            "key.frame_timestamp_micros",
            Cells::Integers(frames.iter().map(|f| frame_time(f)).collect()),
        ),
        column(
            "key.camera_name",
            Cells::Bytes(frames.iter().map(|f| camera_number(&f.camera_id)).collect()),
        ),
        (
            of("image"),
            Cells::Blobs(frames.iter().map(image).collect()),
        ),
        (
            of("pose.transform"),
            Cells::DoubleLists(
                frames
                    .iter()
                    .map(|f| matrix(&ego_at(manifest, f.timestamp_ns)))
                    .collect(),
            ),
        ),
        (of("pose_timestamp"), times(0.0)),
        (
            of("rolling_shutter_params.shutter"),
            Cells::Doubles(vec![SHUTTER_S; frames.len()]),
        ),
        (
            of("rolling_shutter_params.camera_trigger_time"),
            times(-half_s),
        ),
        (
            of("rolling_shutter_params.camera_readout_done_time"),
            times(half_s),
        ),
    ]
}

fn vehicle_poses(log: &v1::DriveLog) -> Vec<Column> {
    let times = frame_times_ns(log);
    let poses = times.iter().map(|&at| matrix(&ego_at(log, at))).collect();
    vec![
        context(times.len()),
        column(
            "key.frame_timestamp_micros",
            Cells::Integers(times.iter().map(|&t| micros(t)).collect()),
        ),
        column(
            "[VehiclePoseComponent].world_from_vehicle.transform",
            Cells::DoubleLists(poses),
        ),
    ]
}

fn lidar_calibration(log: &v1::DriveLog, uniform: bool) -> Vec<Column> {
    let pose = rigid_from_wire(log.sweeps[0].ego_from_lidar.as_ref());
    let beams = elevations_rad();
    // Uniform rows are half a step inside the limits.
    let half_step = (beams[1] - beams[0]) / 2.0;
    let (low, high) = (beams[0] - half_step, beams[beams.len() - 1] + half_step);
    let of = |name: &str| format!("[LiDARCalibrationComponent].{name}");
    let listed = if uniform { Vec::new() } else { beams };
    vec![
        context(1),
        column("key.laser_name", Cells::Bytes(vec![TOP])),
        (
            of("extrinsic.transform"),
            Cells::DoubleLists(vec![matrix(&pose)]),
        ),
        (of("beam_inclination.min"), Cells::Doubles(vec![low])),
        (of("beam_inclination.max"), Cells::Doubles(vec![high])),
        (
            of("beam_inclination.values"),
            Cells::DoubleLists(vec![listed]),
        ),
    ]
}

/// The components `lidar` and `lidar_pose`.
fn range_images(log: &ReadLog) -> (Vec<Column>, Vec<Column>) {
    let manifest = &log.drive_log;
    let (height, width) = (BEAMS as usize, TURN_COLUMNS as usize);
    let (mut images, mut poses) = (Vec::new(), Vec::new());
    for sweep in &manifest.sweeps {
        let mut image = vec![0.0_f32; height * width * 4];
        let mut pose = vec![0.0_f32; height * width * 6];
        for point in returns(log, sweep) {
            let at = pixel(point.position_m);
            let range = point.position_m.length() as f32;
            assert_eq!(image[at * 4], 0.0, "a beam has one return");
            image[at * 4..][..4].copy_from_slice(&[range, point.intensity, 0.0, 0.0]);
            let vehicle = ego_at(manifest, point.timestamp_ns);
            let (yaw, pitch, roll) = vehicle.rotation.to_euler(EulerRot::ZYX);
            let t = vehicle.translation_m;
            let values = [roll, pitch, yaw, t.x, t.y, t.z].map(|v| v as f32);
            pose[at * 6..][..6].copy_from_slice(&values);
        }
        images.push(image);
        poses.push(pose);
    }
    let rows = images.len();
    let key = || {
        let times = frame_times_ns(manifest)
            .iter()
            .map(|&t| micros(t))
            .collect();
        [
            context(rows),
            column("key.frame_timestamp_micros", Cells::Integers(times)),
            column("key.laser_name", Cells::Bytes(vec![TOP; rows])),
        ]
    };
    let shape =
        |channels| Cells::IntegerLists(vec![vec![height as i32, width as i32, channels]; rows]);
    let none = || Cells::FloatLists(vec![Vec::new(); rows]);
    let mut lidar = Vec::from(key());
    lidar.extend([
        column(
            "[LiDARComponent].range_image_return1.values",
            Cells::FloatLists(images),
        ),
        column("[LiDARComponent].range_image_return1.shape", shape(4)),
        column("[LiDARComponent].range_image_return2.values", none()),
        column(
            "[LiDARComponent].range_image_return2.shape",
            Cells::IntegerLists(vec![Vec::new(); rows]),
        ),
    ]);
    let mut lidar_pose = Vec::from(key());
    lidar_pose.extend([
        column(
            "[LiDARPoseComponent].range_image_return1.values",
            Cells::FloatLists(poses),
        ),
        column("[LiDARPoseComponent].range_image_return1.shape", shape(6)),
    ]);
    (lidar, lidar_pose)
}

/// The pixel of a return: the highest beam is the first row, and columns go clockwise from straight back.
fn pixel(p: DVec3) -> usize {
    let elevation = p.z.atan2(p.truncate().length());
    let nearest = |(_, beam): &(usize, f64)| ((beam - elevation).abs() * 1e12) as i64;
    let beams = elevations_rad().into_iter().enumerate();
    let (beam, _) = beams.min_by_key(nearest).expect("the scanner has beams");
    let turned = (PI - p.y.atan2(p.x)) / (2.0 * PI) * f64::from(TURN_COLUMNS);
    (BEAMS as usize - 1 - beam) * TURN_COLUMNS as usize + turned.floor() as usize
}

fn boxes(log: &v1::DriveLog) -> Vec<Column> {
    let (mut times, mut ids) = (Vec::new(), Vec::new());
    let (mut centres, mut sizes, mut headings) = (Vec::new(), Vec::new(), Vec::new());
    for at in frame_times_ns(log) {
        let vehicle_from_world = ego_at(log, at).inverse();
        for track in &log.tracks {
            let pose =
                vehicle_from_world * track_pose_at(track, at).expect("the track covers the log");
            times.push(micros(at));
            ids.push(track.track_id.clone());
            centres.push(pose.translation_m);
            sizes.push(vector_from_wire(track.size_m.as_ref()));
            headings.push(pose.heading_rad());
        }
    }
    let rows = times.len();
    let axis = |of: &[DVec3], i: usize| Cells::Doubles(of.iter().map(|v| v[i]).collect());
    let of = |name: &str| format!("[LiDARBoxComponent].{name}");
    let mut columns = vec![
        context(rows),
        column("key.frame_timestamp_micros", Cells::Integers(times)),
        column("key.laser_object_id", Cells::Texts(ids)),
        (of("box.heading"), Cells::Doubles(headings)),
        (of("type"), Cells::Bytes(vec![1; rows])),
    ];
    for (i, name) in ["x", "y", "z"].iter().enumerate() {
        columns.push((of(&format!("box.center.{name}")), axis(&centres, i)));
        columns.push((of(&format!("box.size.{name}")), axis(&sizes, i)));
    }
    columns
}

/// A table as pyarrow writes it: every column and element optional, lists in three levels.
pub(crate) fn parquet(columns: Vec<Column>, compression: Compression) -> Vec<u8> {
    let fields = columns
        .iter()
        .map(|(name, cells)| field(name, cells))
        .collect();
    let schema = Type::group_type_builder("schema")
        .with_fields(fields)
        .build();
    let properties = WriterProperties::builder()
        .set_compression(compression)
        .build();
    let mut content = Vec::new();
    let schema = Arc::new(schema.expect("the schema is valid"));
    let mut writer = SerializedFileWriter::new(&mut content, schema, Arc::new(properties))
        .expect("the header is written");
    let mut group = writer.next_row_group().expect("a group opens");
    for (_, cells) in columns {
        write_column(&mut group, cells);
    }
    group.close().expect("the group closes");
    writer.close().expect("the footer is written");
    content
}

fn field(name: &str, cells: &Cells) -> TypePtr {
    let (physical, text, list) = match cells {
        Cells::Integers(_) => (PhysicalType::INT64, false, false),
        Cells::Bytes(_) => (PhysicalType::INT32, false, false),
        Cells::Doubles(_) => (PhysicalType::DOUBLE, false, false),
        Cells::Texts(_) => (PhysicalType::BYTE_ARRAY, true, false),
        Cells::Blobs(_) => (PhysicalType::BYTE_ARRAY, false, false),
        Cells::DoubleLists(_) => (PhysicalType::DOUBLE, false, true),
        Cells::FloatLists(_) => (PhysicalType::FLOAT, false, true),
        Cells::IntegerLists(_) => (PhysicalType::INT32, false, true),
    };
    let primitive = |name: &str| {
        let text = if text {
            ConvertedType::UTF8
        } else {
            ConvertedType::NONE
        };
        let built = Type::primitive_type_builder(name, physical)
            .with_repetition(Repetition::OPTIONAL)
            .with_converted_type(text)
            .build();
        Arc::new(built.expect("the type is valid"))
    };
    if !list {
        return primitive(name);
    }
    let group = |name: &str, repetition, converted, inner| {
        let built = Type::group_type_builder(name)
            .with_repetition(repetition)
            .with_converted_type(converted)
            .with_fields(vec![inner])
            .build();
        Arc::new(built.expect("the type is valid"))
    };
    let elements = group(
        "list",
        Repetition::REPEATED,
        ConvertedType::NONE,
        primitive("element"),
    );
    group(name, Repetition::OPTIONAL, ConvertedType::LIST, elements)
}

fn write_column<W: std::io::Write + Send>(
    group: &mut SerializedRowGroupWriter<'_, W>,
    cells: Cells,
) {
    let bytes = |values: Vec<Vec<u8>>| values.into_iter().map(ByteArray::from).collect::<Vec<_>>();
    match cells {
        Cells::Integers(values) => write_scalars::<Int64Type, W>(group, &values),
        Cells::Bytes(values) => write_scalars::<Int32Type, W>(group, &values),
        Cells::Doubles(values) => write_scalars::<DoubleType, W>(group, &values),
        Cells::Texts(values) => {
            let values = values.into_iter().map(String::into_bytes).collect();
            write_scalars::<ByteArrayType, W>(group, &bytes(values));
        }
        Cells::Blobs(values) => write_scalars::<ByteArrayType, W>(group, &bytes(values)),
        Cells::DoubleLists(rows) => write_lists::<DoubleType, W>(group, &rows),
        Cells::FloatLists(rows) => write_lists::<FloatType, W>(group, &rows),
        Cells::IntegerLists(rows) => write_lists::<Int32Type, W>(group, &rows),
    }
}

fn write_scalars<T: DataType, W: std::io::Write + Send>(
    group: &mut SerializedRowGroupWriter<'_, W>,
    values: &[T::T],
) {
    write_levels::<T, W>(group, values, &vec![1; values.len()], None);
}

/// An empty list stands for a missing one.
fn write_lists<T: DataType, W: std::io::Write + Send>(
    group: &mut SerializedRowGroupWriter<'_, W>,
    rows: &[Vec<T::T>],
) {
    let (mut definition, mut repetition) = (Vec::new(), Vec::new());
    for row in rows {
        let levels = row.len().max(1);
        definition.extend(vec![if row.is_empty() { 0 } else { 3 }; levels]);
        repetition.push(0);
        repetition.extend(vec![1; levels - 1]);
    }
    write_levels::<T, W>(group, &rows.concat(), &definition, Some(&repetition));
}

fn write_levels<T: DataType, W: std::io::Write + Send>(
    group: &mut SerializedRowGroupWriter<'_, W>,
    values: &[T::T],
    definition: &[i16],
    repetition: Option<&[i16]>,
) {
    let column = group.next_column().expect("a column opens");
    let mut column = column.expect("the schema has the column");
    let written = column
        .typed::<T>()
        .write_batch(values, Some(definition), repetition);
    written.expect("the values are written");
    column.close().expect("the column closes");
}

/// For checks of whole tables: the columns of a component by name.
pub(crate) fn vehicle_pose_columns(times_us: &[i64], poses: &[Rigid]) -> Vec<Column> {
    let poses: Vec<Vec<f64>> = poses.iter().map(matrix).collect();
    let columns = BTreeMap::from([
        (
            "key.frame_timestamp_micros",
            Cells::Integers(times_us.to_vec()),
        ),
        (
            "[VehiclePoseComponent].world_from_vehicle.transform",
            Cells::DoubleLists(poses),
        ),
    ]);
    columns
        .into_iter()
        .map(|(name, cells)| column(name, cells))
        .collect()
}
