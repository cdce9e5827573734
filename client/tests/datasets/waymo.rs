//! The reader of Waymo Open v2.

use std::fs;
use std::path::{Path, PathBuf};

use backlot_client::read_log::ReadLog;
use backlot_client::waymo::{WaymoInputs, is_waymo, read_waymo};
use backlot_engine::camera::Rigid;
use backlot_proto::v1;
use parquet::basic::Compression;
use tempfile::TempDir;

use crate::same_log::{Comparison, Deviation, FLAWS, LIMITS, deviation};
use crate::street::{street, with_upright_boxes};
use crate::waymo_files::{
    Cells, SEGMENT, camera_name, frame_times_ns, parquet, vehicle_pose_columns, write,
    write_segmentation,
};

fn read(root: &Path) -> Result<ReadLog, String> {
    let inputs = WaymoInputs {
        root: root.to_owned(),
        segment: None,
    };
    read_waymo(&inputs).map_err(|e| e.to_string())
}

/// The street with the lenses of the data set.
fn distorted() -> ReadLog {
    let log = street();
    let times = frame_times_ns(&log.drive_log);
    let mut log = with_upright_boxes(log, &times);
    for camera in &mut log.drive_log.cameras {
        camera.distortion = Some(v1::Distortion {
            model: v1::DistortionModel::BrownConrady.into(),
            coefficients: vec![0.045, -0.34, 0.0016, -0.0003, 0.01],
        });
    }
    log
}

fn there_and_back(log: &ReadLog, uniform: bool) -> Deviation {
    let folder = TempDir::new().expect("a temporary folder");
    write(log, folder.path(), uniform);
    let got = read(folder.path()).expect("the log reads");
    let expected = distorted();
    let how = Comparison {
        box_times_ns: &frame_times_ns(&expected.drive_log),
        camera_id: &camera_name,
        track_id: &str::to_owned,
    };
    deviation(&expected, &got, &how)
}

#[test]
fn a_log_comes_back_the_same() {
    for uniform in [false, true] {
        let found = there_and_back(&distorted(), uniform);
        println!("waymo, uniform beams {uniform}: {found:?}");
        assert!(found.is_within(&LIMITS), "{found:?}");
    }
}

#[test]
fn logs_that_differ_are_told_apart() {
    for (flaw, break_it) in FLAWS {
        let mut log = distorted();
        break_it(&mut log.drive_log);
        let found = there_and_back(&log, false);
        assert!(!found.is_within(&LIMITS), "{flaw}: {found:?}");
    }
    // Boxes that lean in the vehicle's frame cannot be said.
    let mut leaning = distorted();
    leaning.drive_log.tracks = street().drive_log.tracks;
    let found = there_and_back(&leaning, false);
    assert!(found.is_within(&LIMITS), "{found:?}");
    // Without the lens: what an OpenCV order of coefficients that is mixed up would do.
    let mut straight = distorted();
    straight.drive_log.cameras = street().drive_log.cameras;
    let found = there_and_back(&straight, false);
    assert!(found.corner_px > LIMITS.corner_px, "{found:?}");
}

#[test]
fn the_rolling_shutter_is_kept() {
    let data = Data::new();
    assert!(is_waymo(data.folder.path()) && !is_waymo(&data.folder.path().join("lidar")));
    let log = read(data.folder.path()).expect("the log reads").drive_log;
    let frame = &log.frames[0];
    assert_eq!(frame.readout_direction(), v1::ReadoutDirection::LeftToRight);
    assert!(
        (frame.exposure_ns - 6_000_000).abs() < 1000,
        "{}",
        frame.exposure_ns
    );
    assert!(
        (frame.readout_ns - 44_000_000).abs() < 1000,
        "{}",
        frame.readout_ns
    );
    assert_eq!(log.sweeps[0].lidar_id, "TOP");
}

#[test]
fn labelled_sky_becomes_a_mask() {
    let data = Data::new();
    write_segmentation(&street(), data.folder.path());
    let log = read(data.folder.path()).expect("the log reads");
    let masked: Vec<_> = log
        .drive_log
        .frames
        .iter()
        .filter(|f| f.sky_mask.is_some())
        .collect();
    assert_eq!(
        (
            masked.len(),
            masked[0].camera_id.as_str(),
            masked[0].frame_index
        ),
        (1, "FRONT", 0)
    );
    let mask = log
        .read_blob(masked[0].sky_mask.as_ref().expect("a mask"))
        .expect("the mask is readable");
    let mask = image::load_from_memory(&mask)
        .expect("the mask decodes")
        .into_luma8();
    let half = mask.height() / 2;
    for (_, y, pixel) in mask.enumerate_pixels() {
        assert_eq!(pixel.0[0], if y < half { 255 } else { 0 }, "row {y}");
    }
}

struct Data {
    folder: TempDir,
}

impl Data {
    fn new() -> Self {
        let folder = TempDir::new().expect("a temporary folder");
        write(&street(), folder.path(), false);
        Self { folder }
    }

    fn path(&self, component: &str) -> PathBuf {
        self.folder
            .path()
            .join(format!("{component}/{SEGMENT}.parquet"))
    }

    fn put(&self, component: &str, content: &[u8]) {
        fs::write(self.path(component), content).expect("the file is writable");
    }

    fn content(&self, component: &str) -> Vec<u8> {
        fs::read(self.path(component)).expect("the file is there")
    }

    fn remove(&self, component: &str) {
        fs::remove_file(self.path(component)).expect("the file is there");
    }

    fn error(&self) -> String {
        read(self.folder.path()).expect_err("the data is bad")
    }
}

#[test]
fn errors_name_file_and_reason() {
    type Break = fn(&Data);
    let cases: [(&str, Break, &[&str]); 11] = [
        (
            "no poses",
            |d| d.remove("vehicle_pose"),
            &["vehicle_pose", "not found"],
        ),
        (
            "no calibration",
            |d| d.remove("camera_calibration"),
            &["camera_calibration", "not found"],
        ),
        (
            "no calibration of the scanner",
            |d| d.remove("lidar_calibration"),
            &["lidar_calibration", "not found"],
        ),
        (
            "two segments",
            |d| {
                fs::copy(
                    d.path("camera_image"),
                    d.folder.path().join("camera_image/other.parquet"),
                )
                .expect("a copy");
            },
            &["other, street_segment", "--scene"],
        ),
        (
            "a cut table",
            |d| {
                let content = d.content("lidar");
                d.put("lidar", &content[..content.len() / 2]);
            },
            &["lidar/street_segment.parquet", "cut off"],
        ),
        (
            "an empty table",
            |d| d.put("lidar", b""),
            &["lidar/street_segment.parquet", "cut off"],
        ),
        (
            "a damaged table",
            |d| {
                let mut content = d.content("lidar_box");
                let end = content.len() - 8;
                content[end - 40..end].fill(0xff);
                d.put("lidar_box", &content);
            },
            &["lidar_box"],
        ),
        (
            "times out of order",
            |d| {
                d.put(
                    "vehicle_pose",
                    &parquet(
                        vehicle_pose_columns(&[2, 1], &[Rigid::IDENTITY; 2]),
                        Compression::SNAPPY,
                    ),
                )
            },
            &["vehicle_pose", "row 1", "out of order"],
        ),
        (
            "boxes without tracks",
            |d| {
                d.put(
                    "lidar_box",
                    &parquet(
                        vehicle_pose_columns(&[1], &[Rigid::IDENTITY]),
                        Compression::SNAPPY,
                    ),
                )
            },
            &["lidar_box", "no column key.laser_object_id"],
        ),
        (
            "a frame without a pose",
            |d| {
                d.put(
                    "vehicle_pose",
                    &parquet(
                        vehicle_pose_columns(&[1], &[Rigid::IDENTITY]),
                        Compression::SNAPPY,
                    ),
                )
            },
            &["row 0", "no vehicle_pose at"],
        ),
        (
            "a bomb",
            |d| d.put("vehicle_pose", &bomb()),
            &["vehicle_pose", "a page of", "are accepted"],
        ),
    ];
    for (case, break_it, expected) in cases {
        let data = Data::new();
        break_it(&data);
        let error = data.error();
        for text in expected {
            assert!(
                error.contains(text),
                "{case}: {error:?} does not say {text:?}"
            );
        }
        assert_eq!(error.lines().count(), 1, "{case}: {error:?}");
    }
}

#[test]
fn an_image_that_does_not_decode_is_named() {
    let data = Data::new();
    let content = data.content("camera_image");
    // Inside the first image: JPEG files begin with these bytes.
    let start = content
        .windows(3)
        .position(|w| w == [0xff, 0xd8, 0xff])
        .expect("an image");
    let mut broken = content.clone();
    broken[start + 2..start + 40].fill(0);
    data.put("camera_image", &broken);
    let error = data.error();
    for text in ["camera_image", "row 0", "FRONT", "does not decode"] {
        assert!(error.contains(text), "{error}");
    }
}

/// A pose table of a few kilobytes one of whose rows unpacks to nine million numbers.
fn bomb() -> Vec<u8> {
    let columns = vec![
        (
            "key.frame_timestamp_micros".to_owned(),
            Cells::Integers(vec![1]),
        ),
        (
            "[VehiclePoseComponent].world_from_vehicle.transform".to_owned(),
            Cells::DoubleLists(vec![vec![1.0; 9 << 20]]),
        ),
    ];
    let content = parquet(columns, Compression::ZSTD(Default::default()));
    assert!(content.len() < 1 << 20, "{} bytes", content.len());
    content
}
