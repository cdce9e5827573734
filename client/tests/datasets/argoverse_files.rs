//! Writes a log as the Argoverse 2 sensor data set does: Feather tables and sweeps, JPEG images.

use std::path::Path;
use std::sync::Arc;

use arrow_array::{
    ArrayRef, Float16Array, Float64Array, Int32Array, Int64Array, RecordBatch, StringArray,
    UInt8Array,
};
use arrow_ipc::CompressionType;
use arrow_ipc::writer::{FileWriter, IpcWriteOptions};
use backlot_client::geometry::{rigid_from_wire, vector_from_wire};
use backlot_client::motion::track_pose_at;
use backlot_client::read_log::ReadLog;
use backlot_engine::camera::Rigid;
use backlot_proto::v1;
use glam::DVec3;
use half::f16;

use crate::nuscenes_files::put;
use crate::street::{compensated, ego_at};

/// The folder of the log below the split's.
pub(crate) const LOG: &str = "street-log";

/// Writes the log below `root/street-log`. Sweeps have half floats, as the data set has.
pub(crate) fn write(log: &ReadLog, root: &Path) {
    let folder = root.join(LOG);
    let manifest = &log.drive_log;
    write_calibration(log, &folder);
    let frames = manifest.frames.iter().map(|f| f.timestamp_ns);
    let mut times: Vec<i64> = frames
        .chain(manifest.sweeps.iter().map(|s| s.timestamp_ns))
        .collect();
    times.sort_unstable();
    times.dedup();
    let poses: Vec<Rigid> = times.iter().map(|&at| ego_at(manifest, at)).collect();
    let mut columns = vec![("timestamp_ns", integers(times))];
    columns.extend(pose_columns(&poses));
    put_feather(&folder, "city_SE3_egovehicle.feather", columns);
    write_annotations(log, &folder);
    for frame in &manifest.frames {
        let blob = frame.image.as_ref().expect("a frame has an image");
        let name = format!(
            "sensors/cameras/{}/{}.jpg",
            frame.camera_id, frame.timestamp_ns
        );
        put(
            &folder,
            &name,
            &log.read_blob(blob).expect("the image is readable"),
        );
    }
    write_sweeps(log, &folder);
}

/// The log with its returns where half floats of the ego frame put them.
pub(crate) fn rounded(mut log: ReadLog) -> ReadLog {
    for i in 0..log.drive_log.sweeps.len() {
        let sweep = log.drive_log.sweeps[i].clone();
        let ego_from_lidar = rigid_from_wire(sweep.ego_from_lidar.as_ref());
        let mut points = Vec::new();
        for point in compensated(&log, &sweep) {
            let ego = ego_from_lidar.point(point.position_m).to_array();
            let ego = DVec3::from_array(ego.map(|v| f16::from_f64(v).to_f64()));
            let p = ego_from_lidar.inverse().point(ego).as_vec3();
            for value in [p.x, p.y, p.z, point.intensity] {
                points.extend_from_slice(&value.to_le_bytes());
            }
        }
        let blob = log.add_bytes(points);
        log.drive_log.sweeps[i].points = Some(blob);
        log.drive_log.sweeps[i].format = v1::PointFormat::XyziF32.into();
    }
    log
}

fn write_calibration(log: &ReadLog, folder: &Path) {
    let cameras = &log.drive_log.cameras;
    let numbers = |of: &dyn Fn(&v1::Camera) -> f64| -> ArrayRef {
        Arc::new(
            cameras
                .iter()
                .map(|c| Some(of(c)))
                .collect::<Float64Array>(),
        )
    };
    let names = cameras.iter().map(|c| Some(c.camera_id.clone()));
    put_feather(
        folder,
        "calibration/intrinsics.feather",
        vec![
            (
                "sensor_name",
                Arc::new(names.clone().collect::<StringArray>()),
            ),
            ("fx_px", numbers(&|c| c.focal_x_px)),
            ("fy_px", numbers(&|c| c.focal_y_px)),
            ("cx_px", numbers(&|c| c.principal_x_px - 0.5)),
            ("cy_px", numbers(&|c| c.principal_y_px - 0.5)),
            // Of the raw images: those of the data set are undistorted.
            ("k1", numbers(&|_| -0.25)),
            ("k2", numbers(&|_| -0.2)),
            ("k3", numbers(&|_| 0.3)),
            (
                "height_px",
                integers(cameras.iter().map(|c| c.height.into()).collect()),
            ),
            (
                "width_px",
                integers(cameras.iter().map(|c| c.width.into()).collect()),
            ),
        ],
    );
    let lidar = log.drive_log.sweeps[0].ego_from_lidar.as_ref();
    let places: Vec<Rigid> = cameras
        .iter()
        .map(|c| c.ego_from_camera.as_ref())
        .chain([lidar, lidar])
        .map(rigid_from_wire)
        .collect();
    let lidars = ["up_lidar", "down_lidar"].map(|name| Some(name.to_owned()));
    let names: StringArray = names.chain(lidars).collect();
    let mut columns = vec![("sensor_name", Arc::new(names) as ArrayRef)];
    columns.extend(pose_columns(&places));
    put_feather(folder, "calibration/egovehicle_SE3_sensor.feather", columns);
}

fn write_annotations(log: &ReadLog, folder: &Path) {
    let manifest = &log.drive_log;
    let (mut times, mut ids, mut categories) = (Vec::new(), Vec::new(), Vec::new());
    let (mut sizes, mut poses) = (Vec::new(), Vec::new());
    for sweep in &manifest.sweeps {
        let ego_from_world = ego_at(manifest, sweep.timestamp_ns).inverse();
        for track in &manifest.tracks {
            let pose = track_pose_at(track, sweep.timestamp_ns).expect("the track covers the log");
            times.push(sweep.timestamp_ns);
            ids.push(track.track_id.clone());
            categories.push(if track.source_class == "van" {
                "LARGE_VEHICLE"
            } else {
                "REGULAR_VEHICLE"
            });
            sizes.push(vector_from_wire(track.size_m.as_ref()));
            poses.push(ego_from_world * pose);
        }
    }
    let rows = times.len() as i64;
    let side = |axis: usize| floats(sizes.iter().map(|size| size[axis]).collect());
    let mut columns = vec![
        ("timestamp_ns", integers(times)),
        ("track_uuid", Arc::new(StringArray::from(ids)) as ArrayRef),
        ("category", Arc::new(StringArray::from(categories))),
        ("length_m", side(0)),
        ("width_m", side(1)),
        ("height_m", side(2)),
        ("num_interior_pts", integers((0..rows).collect())),
    ];
    columns.extend(pose_columns(&poses));
    put_feather(folder, "annotations.feather", columns);
}

fn write_sweeps(log: &ReadLog, folder: &Path) {
    for sweep in &log.drive_log.sweeps {
        let ego_from_lidar = rigid_from_wire(sweep.ego_from_lidar.as_ref());
        let points = compensated(log, sweep);
        let ego: Vec<_> = points
            .iter()
            .map(|p| ego_from_lidar.point(p.position_m))
            .collect();
        let side = |axis: usize| -> ArrayRef {
            let halves = ego.iter().map(|p| Some(f16::from_f64(p[axis])));
            Arc::new(halves.collect::<Float16Array>())
        };
        let intensity = points.iter().map(|p| (p.intensity * 255.0).round() as u8);
        let lasers = (0..points.len()).map(|i| (i % 64) as u8);
        put_feather(
            folder,
            &format!("sensors/lidar/{}.feather", sweep.timestamp_ns),
            vec![
                ("x", side(0)),
                ("y", side(1)),
                ("z", side(2)),
                (
                    "intensity",
                    Arc::new(intensity.collect::<UInt8Array>()) as ArrayRef,
                ),
                ("laser_number", Arc::new(lasers.collect::<UInt8Array>())),
                (
                    "offset_ns",
                    Arc::new(Int32Array::from(vec![0; points.len()])),
                ),
            ],
        );
    }
}

fn pose_columns(poses: &[Rigid]) -> Vec<(&'static str, ArrayRef)> {
    let column = |of: &dyn Fn(&Rigid) -> f64| floats(poses.iter().map(of).collect());
    vec![
        ("qw", column(&|p| p.rotation.w)),
        ("qx", column(&|p| p.rotation.x)),
        ("qy", column(&|p| p.rotation.y)),
        ("qz", column(&|p| p.rotation.z)),
        ("tx_m", column(&|p| p.translation_m.x)),
        ("ty_m", column(&|p| p.translation_m.y)),
        ("tz_m", column(&|p| p.translation_m.z)),
    ]
}

pub(crate) fn floats(values: Vec<f64>) -> ArrayRef {
    Arc::new(Float64Array::from(values))
}

pub(crate) fn integers(values: Vec<i64>) -> ArrayRef {
    Arc::new(Int64Array::from(values))
}

/// Writes a table as pandas does: one LZ4-compressed batch.
pub(crate) fn put_feather(folder: &Path, name: &str, columns: Vec<(&'static str, ArrayRef)>) {
    put(
        folder,
        name,
        &feather(columns, Some(CompressionType::LZ4_FRAME)),
    );
}

pub(crate) fn feather(
    columns: Vec<(&'static str, ArrayRef)>,
    compression: Option<CompressionType>,
) -> Vec<u8> {
    let batch = RecordBatch::try_from_iter(columns).expect("columns are of one length");
    let options = IpcWriteOptions::default().try_with_compression(compression);
    let options = options.expect("the compression is built in");
    let mut content = Vec::new();
    let mut writer = FileWriter::try_new_with_options(&mut content, &batch.schema(), options)
        .expect("the header is written");
    writer.write(&batch).expect("the batch is written");
    writer.finish().expect("the footer is written");
    drop(writer);
    content
}
